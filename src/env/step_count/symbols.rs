//! The symbols of parameters in papers, and the names of their quantities.

/// A parameter that papers write as a symbol.
#[derive(Clone, Copy, Debug)]
pub struct Symbol {
    /// The key.
    pub key: &'static str,
    /// The symbol; `_` begins a subscript.
    pub symbol: &'static str,
    /// The name of the quantity, if axes have one.
    pub quantity: Option<&'static str>,
}

const fn symbol(key: &'static str, symbol: &'static str, quantity: Option<&'static str>) -> Symbol {
    Symbol { key, symbol, quantity }
}

/// The symbols of the keys of the environment.
pub const SYMBOLS: &[Symbol] = &[
    symbol("sigma_s", "σ_s", Some("noise of steps")),
    symbol("sigma", "σ", Some("feature noise")),
    symbol("mu", "μ", None),
    symbol("delta_h", "δ_h", Some("habituation decay")),
    symbol("delta_d", "δ_d", Some("disengagement decay")),
    symbol("epsilon_h", "ε_h", Some("habituation increment")),
    symbol("epsilon_d", "ε_d", Some("disengagement increment")),
    symbol("rho_1", "ρ_1", Some("effect of an untailored message")),
    symbol("rho_2", "ρ_2", Some("effect of a tailored message")),
];
