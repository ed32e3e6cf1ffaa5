//! Structs and constants that shaders share with Rust: written once here, in Rust, from which the shaders' text is made.
//!
//! *Practice.* [`gpu_struct!`](crate::gpu_struct) declares a struct and its WGSL twin. WGSL pads where its alignment asks for it, and
//! Rust does not: [`GpuStruct::FIELDS`] keeps Rust's offsets, and a test lets naga lay the text out and compares every member. So
//! a struct that would need padding fails that test, and gets a member that fills the gap.

/// A type that has the same bits in a buffer and in Rust.
pub trait WgslType: bytemuck::Pod {
    /// Its name in WGSL.
    const NAME: &'static str;
}

macro_rules! wgsl_types {
    ($($rust:ty => $wgsl:literal),* $(,)?) => {
        $(impl WgslType for $rust { const NAME: &'static str = $wgsl; })*
    };
}

wgsl_types! {
    f32 => "f32",
    u32 => "u32",
    i32 => "i32",
    [f32; 2] => "vec2<f32>",
    [f32; 3] => "vec3<f32>",
    [f32; 4] => "vec4<f32>",
    [u32; 2] => "vec2<u32>",
    [u32; 3] => "vec3<u32>",
    [u32; 4] => "vec4<u32>",
    [i32; 2] => "vec2<i32>",
    [i32; 3] => "vec3<i32>",
    [i32; 4] => "vec4<i32>",
    [[f32; 4]; 3] => "mat3x4<f32>",
    [[f32; 4]; 4] => "mat4x4<f32>",
}

/// A struct with a WGSL twin; implemented by [`gpu_struct!`](crate::gpu_struct).
pub trait GpuStruct: bytemuck::Pod {
    /// Its name, in both languages.
    const NAME: &'static str;
    /// Its members: name, WGSL type, offset in Rust.
    const FIELDS: &'static [(&'static str, &'static str, usize)];

    /// The twin's declaration.
    fn wgsl() -> String {
        let members: String = Self::FIELDS.iter().map(|(name, kind, _)| format!("    {name}: {kind},\n")).collect();
        format!("struct {} {{\n{members}}}\n", Self::NAME)
    }
}

/// Declares a struct that buffers hold, with its WGSL twin: see [`layout`](crate::gpu::layout).
#[macro_export]
macro_rules! gpu_struct {
    ($(#[$outer:meta])* $vis:vis struct $name:ident { $($(#[$inner:meta])* $field:ident: $kind:ty,)* }) => {
        $(#[$outer])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(C)]
        $vis struct $name { $($(#[$inner])* pub $field: $kind,)* }

        impl $crate::gpu::layout::GpuStruct for $name {
            const NAME: &'static str = stringify!($name);
            const FIELDS: &'static [(&'static str, &'static str, usize)] = &[
                $((stringify!($field), <$kind as $crate::gpu::layout::WgslType>::NAME, ::std::mem::offset_of!($name, $field)),)*
            ];
        }
    };
}

/// The declaration of a WGSL constant.
pub fn constant(name: &str, value: impl Into<Constant>) -> String {
    match value.into() {
        Constant::U32(value) => format!("const {name}: u32 = {value}u;\n"),
        Constant::I32(value) => format!("const {name}: i32 = {value}i;\n"),
        // All digits that tell this float from its neighbours.
        Constant::F32(value) => format!("const {name}: f32 = {value:e}f;\n"),
    }
}

/// The value of a constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Constant {
    /// `u32`.
    U32(u32),
    /// `i32`.
    I32(i32),
    /// `f32`, finite.
    F32(f32),
}

impl From<u32> for Constant {
    fn from(value: u32) -> Self {
        Self::U32(value)
    }
}

impl From<i32> for Constant {
    fn from(value: i32) -> Self {
        Self::I32(value)
    }
}

impl From<f32> for Constant {
    fn from(value: f32) -> Self {
        Self::F32(value)
    }
}

/// Asserts that the WGSL twin of `T` has every member where Rust has it, and the same stride.
#[cfg(test)]
pub fn assert_same_layout<T: GpuStruct>() {
    let text = format!("{}@group(0) @binding(0) var<storage, read> all: array<{}>;\n", T::wgsl(), T::NAME);
    let module = naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&text)));
    let members = module.types.iter().find_map(|(_, kind)| match &kind.inner {
        naga::TypeInner::Struct { members, span } if kind.name.as_deref() == Some(T::NAME) => Some((members, *span)),
        _ => None,
    });
    let (members, span) = members.expect("the struct is declared");
    assert_eq!(span as usize, std::mem::size_of::<T>(), "the size of {}", T::NAME);
    for (member, (name, _, offset)) in members.iter().zip(T::FIELDS) {
        assert_eq!(member.offset as usize, *offset, "{}.{name}", T::NAME);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    gpu_struct! {
        /// Packed as both languages pack it.
        struct Packed {
            /// Fills sixteen bytes with the next.
            normal: [f32; 3],
            /// After it.
            depth: f32,
            /// Two words.
            pair: [u32; 2],
            /// And two more.
            rest: [i32; 2],
        }
    }

    gpu_struct! {
        /// WGSL moves the vector to sixteen bytes, Rust to four.
        struct Padded {
            /// Four bytes.
            depth: f32,
            /// Aligned differently.
            normal: [f32; 3],
        }
    }

    #[test]
    fn a_struct_without_gaps_has_one_layout() {
        assert_same_layout::<Packed>();
    }

    #[test]
    #[should_panic(expected = "Padded")]
    fn a_struct_with_a_gap_is_found() {
        assert_same_layout::<Padded>();
    }

    #[test]
    fn constants_keep_every_bit() {
        for value in [0.1_f32, 1e-30, 16_777_217.0, -3.5, f32::MIN_POSITIVE] {
            let text = constant("VALUE", value);
            let digits = text.trim_start_matches("const VALUE: f32 = ").trim_end_matches("f;\n");
            assert_eq!(digits.parse::<f32>().unwrap().to_bits(), value.to_bits(), "{text}");
            naga::front::wgsl::parse_str(&text).unwrap();
        }
    }
}
