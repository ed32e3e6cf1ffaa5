//! The judge: f64 ray casting.
