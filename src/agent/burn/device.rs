//! The tensor backend; no other file names it.

use burn::tensor::Device;

/// The device on which networks are evaluated.
#[cfg(not(feature = "burn-flex"))]
pub fn inference() -> Device {
    // Upstream has deprecated ndarray in favour of flex, which `--features burn-flex` selects.
    #[allow(deprecated)]
    Device::ndarray()
}

/// The device on which networks are evaluated.
#[cfg(feature = "burn-flex")]
pub fn inference() -> Device {
    Device::flex()
}

/// The device on which networks are trained: the inference device with recording of gradients.
pub fn training() -> Device {
    inference().autodiff()
}
