//! What needs a GPU. Without an adapter every test here is reported as ignored, never as passed; with `SURFCUT_NEEDS_GPU` set in the
//! environment that is a failure, which is how `.ci/run` runs them.

mod blister;
mod composite;
mod core;
mod fragment;
mod hybrid;
mod merged;
mod shadow;
mod splat;
mod tied;

use std::process::ExitCode;

use libtest_mimic::{Arguments, Failed, Trial};
use surfcut::gpu::Gpu;

/// A test: its name and what it does. A panic fails it.
pub type Test = (&'static str, fn(&'static Gpu));

fn main() -> ExitCode {
    let arguments = Arguments::from_args();
    let tests: Vec<Test> = [
        core::TESTS,
        blister::TESTS,
        composite::TESTS,
        shadow::TESTS,
        splat::TESTS,
        fragment::TESTS,
        hybrid::TESTS,
        merged::TESTS,
        tied::TESTS,
    ]
    .concat();
    let gpu: Option<&'static Gpu> = match Gpu::open(None) {
        Ok(gpu) => Some(Box::leak(Box::new(gpu))),
        Err(error) if std::env::var_os("SURFCUT_NEEDS_GPU").is_some() => {
            eprintln!("SURFCUT_NEEDS_GPU is set, and {error}");
            return ExitCode::FAILURE;
        }
        Err(_) => None,
    };
    let trial = |(name, test): Test| {
        let run = move || match gpu {
            Some(gpu) => {
                test(gpu);
                Ok(())
            }
            None => Err(Failed::from("there is no adapter")),
        };
        Trial::test(name, run).with_ignored_flag(gpu.is_none())
    };
    libtest_mimic::run(&arguments, tests.into_iter().map(trial).collect()).exit_code()
}
