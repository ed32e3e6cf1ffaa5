//! Shaders, put together from files, structs and constants.
//!
//! *Practice.* Every shader that the crate can make is in [`all`], so that one test lets naga check every entry point without a
//! GPU. A file under `shaders/` has the name of the stage whose twin it is.

use super::blister::Traits;
use super::layout::GpuStruct;

/// One module of WGSL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shader {
    /// Its name, for messages.
    pub name: &'static str,
    /// All of it.
    pub text: String,
}

impl Shader {
    /// A module that begins with what all share.
    pub fn new(name: &'static str) -> Self {
        let text = super::layout::constant("WORKGROUP", WORKGROUP) + include_str!("../../shaders/threads.wgsl");
        Self { name, text }
    }

    /// With a struct's declaration.
    #[must_use]
    pub fn with_struct<T: GpuStruct>(mut self) -> Self {
        self.text += &T::wgsl();
        self
    }

    /// With a constant's declaration.
    #[must_use]
    pub fn with_constant(mut self, name: &str, value: impl Into<super::layout::Constant>) -> Self {
        self.text += &super::layout::constant(name, value);
        self
    }

    /// With the text of a file.
    #[must_use]
    pub fn with_text(mut self, text: &str) -> Self {
        self.text += text;
        self
    }
}

/// Threads of a workgroup, in one row.
pub const WORKGROUP: u32 = 64;

/// Every module, as [`Gpu`](super::Gpu) may be asked to compile it.
pub fn all() -> Vec<Shader> {
    let mut all = vec![super::scan::shader(), super::merged::shader()];
    // One word, and more than one; steps in memory, and in registers.
    all.extend([1, 5].map(|words| super::blister::shader(Traits::general(words))));
    all.extend([1, 4].map(|steps| super::blister::shader(Traits::simple(steps))));
    all.extend(super::composite::shaders());
    all.extend(super::splat::all());
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shader_is_valid() {
        for shader in all() {
            let module = naga::front::wgsl::parse_str(&shader.text)
                .unwrap_or_else(|e| panic!("{}: {}", shader.name, e.emit_to_string(&shader.text)));
            let flags = naga::valid::ValidationFlags::all();
            // No more than what WebGPU promises everywhere.
            let mut validator = naga::valid::Validator::new(flags, naga::valid::Capabilities::empty());
            let checked = validator.validate(&module);
            checked.unwrap_or_else(|e| panic!("{}: {}", shader.name, e.emit_to_string(&shader.text)));
            assert!(!module.entry_points.is_empty(), "{} has no entry point", shader.name);
        }
    }
}
