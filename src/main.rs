//! The surfcut command.

use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    // Mesa puts a layer before every driver that asks a display server which GPU it draws on, and prints an error where there is none,
    // as on any server. The order of adapters is surfcut's own, so the layer has nothing to do.
    #[cfg(all(feature = "gpu", target_os = "linux"))]
    // SAFETY: no other thread runs yet that could read the environment meanwhile.
    unsafe {
        std::env::set_var("NODEVICE_SELECT", "1");
    }
    ExitCode::from(cli::run())
}
