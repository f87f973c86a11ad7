//! The letters of names and labels: what figures can draw of them, and how LaTeX writes them.

use std::collections::BTreeSet;

use super::scene::is_drawn;

/// The letters of these texts that no figure can draw, each once, in the order of their codes. Figures show boxes for
/// them, and pdflatex refuses them.
pub fn undrawn<'t>(texts: impl IntoIterator<Item = &'t str>) -> BTreeSet<char> {
    let letters = texts.into_iter().flat_map(str::chars);
    letters.filter(|letter| !letter.is_control() && !is_drawn(*letter)).collect()
}

/// How LaTeX writes a character.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tex {
    /// As it is.
    Same,
    /// These characters.
    Text(&'static str),
    /// A command or letter of mathematics.
    Math(&'static str),
    /// As it is, in an encoding that the document loads with the package `fontenc`.
    Encoded(&'static str),
}

/// How LaTeX writes a character of a text.
pub(super) fn tex(character: char) -> Tex {
    if let Some((_, math)) = GREEK.iter().chain(SIGNS).find(|(known, _)| *known == character) {
        return Tex::Math(math);
    }
    if let Some((_, text)) = TEXTS.iter().find(|(known, _)| *known == character) {
        return Tex::Text(text);
    }
    match character {
        '«' | '»' | '‹' | '›' | '‚' | '„' => Tex::Encoded("T1"),
        'Ð' | 'Þ' | 'ð' | 'þ' | 'Đ' | 'đ' | 'Ŋ' | 'ŋ' => Tex::Encoded("T1"),
        'Ą' | 'ą' | 'Ę' | 'ę' | 'Į' | 'į' | 'Ų' | 'ų' => Tex::Encoded("T1"),
        'Ơ' | 'ơ' | 'Ư' | 'ư' | '\u{1ea0}'..='\u{1ef9}' => Tex::Encoded("T5"),
        '\u{400}'..='\u{4ff}' => Tex::Encoded("T2A"),
        _ => Tex::Same,
    }
}

/// The name of a Greek letter without an accent, as LaTeX spells it.
pub(super) fn greek_name(letter: char) -> Option<&'static str> {
    let (_, math) = GREEK.iter().find(|(known, _)| *known == letter)?;
    math.strip_prefix('\\').filter(|name| !name.contains('{'))
}

const GREEK: &[(char, &str)] = &[
    ('α', "\\alpha"),
    ('β', "\\beta"),
    ('γ', "\\gamma"),
    ('δ', "\\delta"),
    ('ε', "\\epsilon"),
    ('ζ', "\\zeta"),
    ('η', "\\eta"),
    ('θ', "\\theta"),
    ('ι', "\\iota"),
    ('κ', "\\kappa"),
    ('λ', "\\lambda"),
    ('μ', "\\mu"),
    ('ν', "\\nu"),
    ('ξ', "\\xi"),
    ('ο', "o"),
    ('π', "\\pi"),
    ('ρ', "\\rho"),
    ('ς', "\\varsigma"),
    ('σ', "\\sigma"),
    ('τ', "\\tau"),
    ('υ', "\\upsilon"),
    ('φ', "\\phi"),
    ('χ', "\\chi"),
    ('ψ', "\\psi"),
    ('ω', "\\omega"),
    ('Α', "\\mathrm{A}"),
    ('Β', "\\mathrm{B}"),
    ('Γ', "\\Gamma"),
    ('Δ', "\\Delta"),
    ('Ε', "\\mathrm{E}"),
    ('Ζ', "\\mathrm{Z}"),
    ('Η', "\\mathrm{H}"),
    ('Θ', "\\Theta"),
    ('Ι', "\\mathrm{I}"),
    ('Κ', "\\mathrm{K}"),
    ('Λ', "\\Lambda"),
    ('Μ', "\\mathrm{M}"),
    ('Ν', "\\mathrm{N}"),
    ('Ξ', "\\Xi"),
    ('Ο', "\\mathrm{O}"),
    ('Π', "\\Pi"),
    ('Ρ', "\\mathrm{P}"),
    ('Σ', "\\Sigma"),
    ('Τ', "\\mathrm{T}"),
    ('Υ', "\\Upsilon"),
    ('Φ', "\\Phi"),
    ('Χ', "\\mathrm{X}"),
    ('Ψ', "\\Psi"),
    ('Ω', "\\Omega"),
    ('ά', "\\acute{\\alpha}"),
    ('έ', "\\acute{\\epsilon}"),
    ('ή', "\\acute{\\eta}"),
    ('ί', "\\acute{\\iota}"),
    ('ό', "\\acute{o}"),
    ('ύ', "\\acute{\\upsilon}"),
    ('ώ', "\\acute{\\omega}"),
    ('Ά', "\\acute{\\mathrm{A}}"),
    ('Έ', "\\acute{\\mathrm{E}}"),
    ('Ή', "\\acute{\\mathrm{H}}"),
    ('Ί', "\\acute{\\mathrm{I}}"),
    ('Ό', "\\acute{\\mathrm{O}}"),
    ('Ύ', "\\acute{\\Upsilon}"),
    ('Ώ', "\\acute{\\Omega}"),
    ('ϊ', "\\ddot{\\iota}"),
    ('ϋ', "\\ddot{\\upsilon}"),
    ('Ϊ', "\\ddot{\\mathrm{I}}"),
    ('Ϋ', "\\ddot{\\Upsilon}"),
    ('ΐ', "\\acute{\\ddot{\\iota}}"),
    ('ΰ', "\\acute{\\ddot{\\upsilon}}"),
    ('ϑ', "\\vartheta"),
    ('ϕ', "\\phi"),
    ('ϵ', "\\epsilon"),
    ('ϱ', "\\varrho"),
    ('ϖ', "\\varpi"),
];

const SIGNS: &[(char, &str)] = &[
    ('−', "-"),
    ('±', "\\pm"),
    ('×', "\\times"),
    ('·', "\\cdot"),
    ('≥', "\\geq"),
    ('≤', "\\leq"),
    ('<', "<"),
    ('>', ">"),
    ('≈', "\\approx"),
    ('≠', "\\neq"),
    ('∞', "\\infty"),
    ('∂', "\\partial"),
    ('∆', "\\Delta"),
    ('∏', "\\prod"),
    ('∑', "\\sum"),
    ('√', "\\surd"),
    ('←', "\\leftarrow"),
    ('↑', "\\uparrow"),
    ('→', "\\rightarrow"),
    ('↓', "\\downarrow"),
    ('↔', "\\leftrightarrow"),
    ('⇒', "\\Rightarrow"),
    ('⇔', "\\Leftrightarrow"),
    ('′', "{}'"),
    ('″', "{}''"),
    ('●', "\\bullet"),
    ('○', "\\circ"),
    ('▲', "\\triangle"),
    ('△', "\\triangle"),
    ('▼', "\\nabla"),
    ('▽', "\\nabla"),
    ('◆', "\\diamond"),
    ('◇', "\\diamond"),
    ('▶', "\\triangleright"),
    ('◀', "\\triangleleft"),
    ('µ', "\\mu"),
    ('¬', "\\neg"),
    ('⁄', "/"),
    ('℃', "^{\\circ}\\mathrm{C}"),
    ('⁰', "^{0}"),
    ('¹', "^{1}"),
    ('²', "^{2}"),
    ('³', "^{3}"),
    ('⁴', "^{4}"),
    ('⁵', "^{5}"),
    ('⁶', "^{6}"),
    ('⁷', "^{7}"),
    ('⁸', "^{8}"),
    ('⁹', "^{9}"),
    ('⁺', "^{+}"),
    ('⁻', "^{-}"),
    ('ⁿ', "^{n}"),
    ('₀', "_{0}"),
    ('₁', "_{1}"),
    ('₂', "_{2}"),
    ('₃', "_{3}"),
    ('₄', "_{4}"),
    ('₅', "_{5}"),
    ('₆', "_{6}"),
    ('₇', "_{7}"),
    ('₈', "_{8}"),
    ('₉', "_{9}"),
    ('₊', "_{+}"),
    ('₋', "_{-}"),
];

const TEXTS: &[(char, &str)] = &[
    ('\\', "\\textbackslash{}"),
    ('~', "\\textasciitilde{}"),
    ('^', "\\textasciicircum{}"),
    ('■', "\\rule{1.2ex}{1.2ex}"),
    ('□', "\\fbox{\\rule{0pt}{0.6ex}\\rule{0.6ex}{0pt}}"),
    ('Ħ', "\\rlap{\\raisebox{0.35ex}{--}}H"),
    ('ħ', "\\rlap{\\raisebox{0.35ex}{-}}h"),
    ('Ŧ', "\\rlap{\\raisebox{0.1ex}{\\,-}}T"),
    ('ŧ', "\\rlap{\\raisebox{0.1ex}{-}}t"),
    ('Ŀ', "L\\textperiodcentered{}"),
    ('ŀ', "l\\textperiodcentered{}"),
    ('‐', "-"),
    ('‑', "\\mbox{-}"),
    ('ẞ', "SS"),
    ('{', "\\{"),
    ('}', "\\}"),
    ('$', "\\$"),
    ('&', "\\&"),
    ('#', "\\#"),
    ('_', "\\_"),
    ('%', "\\%"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_that_no_figure_can_draw_are_listed_once() {
        let names = ["Señal", "règle", "агент", "日本日", "x 😀"];
        assert_eq!(undrawn(names).into_iter().collect::<String>(), "日本😀");
        assert!(undrawn(["λ → 0", "κ_h ≈ δ_h"]).is_empty());
    }

    #[test]
    fn latex_knows_what_figures_can_draw() {
        // Latin letters that pdflatex knows in every encoding, and signs that it knows with the encoding TS1.
        let is_known = |c: char| {
            c.is_ascii()
                || ('\u{a0}'..'\u{17f}').contains(&c)
                || "ȘșȚțẞ–—‘’“”…‰†‡•⁄€℃№™■".contains(c)
        };
        for character in ('\u{20}'..='\u{ffff}').filter(|character| is_drawn(*character)) {
            assert!(is_known(character) || tex(character) != Tex::Same, "{character}");
        }
        let listed = GREEK.iter().chain(SIGNS).chain(TEXTS);
        let unknown: String = listed.map(|(known, _)| *known).filter(|c| !is_drawn(*c)).collect();
        assert_eq!(unknown, "");
    }

    #[test]
    fn greek_letters_have_names() {
        let names = ['σ', 'λ', 'Φ', 'ά', 'ο', 'x'].map(greek_name);
        assert_eq!(names, [Some("sigma"), Some("lambda"), Some("Phi"), None, None, None]);
    }
}
