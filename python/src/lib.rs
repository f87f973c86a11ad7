//! The native part of the Python module `jitai`: environments, experiments, fits, stores and policies as Python objects.
//!
//! In: Python values and NumPy arrays. Out: the same. The library computes everything; this crate converts
//! values, checks inputs, and maps errors to Python exceptions. The package around it, `package/jitai/`,
//! has the public classes.

mod declaration;
mod errors;
mod experiment;
mod fit;
mod info;
mod interrupt;
mod lane;
mod lanes;
mod policy;
mod store;

use pyo3::prelude::*;

/// The native part of `jitai`; use the package, not this module.
#[pymodule]
mod _jitai {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::declaration::Declaration;
    #[pymodule_export]
    use crate::experiment::{ManifestError, check, figures, plan, report, run};
    #[pymodule_export]
    use crate::fit::{FittedPilot, fit};
    #[pymodule_export]
    use crate::lane::Lane;
    #[pymodule_export]
    use crate::lanes::Lanes;
    #[pymodule_export]
    use crate::policy::TrainedPolicy;
    #[pymodule_export]
    use crate::store::StoreReader;

    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // The actions of a recorded trial are those of its file: nobody can act in it.
        let is_simulated = |family: &&&jitai::environment::Family| {
            !family.is_external() && family.name != "recorded"
        };
        let families = jitai::environment::Family::all().iter().filter(is_simulated);
        module.add("FAMILIES", families.map(|family| family.name).collect::<Vec<_>>())?;
        crate::interrupt::load_numpy(module.py())
    }
}
