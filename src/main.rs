//! The surfcut command.
fn main() {}
