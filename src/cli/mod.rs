//! The command: flags to library to files. Only this module and `main` print or set the exit code.

pub mod args;
mod backend;
mod chart;
mod check;
mod compare;
mod engine;
mod failure;
mod info;
mod input;
mod memory;
mod progress;
mod render;
mod sequence;
mod shadows;
mod style_args;

use std::io::{self, Write};
use std::path::Path;

use clap::{CommandFactory, Parser};
use surfcut::output::Destination;

use args::{Cli, Command, Common};
use failure::code;
use progress::Bars;

/// What the flags that every command takes come to.
pub struct Session {
    common: Common,
    /// Progress bars.
    pub bars: Bars,
}

impl Session {
    /// Tells the user on standard error, unless they asked for quiet.
    pub fn tell(&self, text: &str) {
        if !self.common.quiet {
            // Nobody is left to tell of a failure to tell.
            let _ = writeln!(io::stderr(), "{text}");
        }
    }

    /// Prints a command's result on standard output, unless the user asked for quiet or the summary goes there.
    pub fn print(&self, text: &str) -> io::Result<()> {
        let is_taken = self.common.summary_file.as_deref() == Some(Path::new("-"));
        if self.common.quiet || is_taken { Ok(()) } else { print(text.as_bytes()) }
    }

    /// Whether outputs that exist are replaced.
    pub fn overwrite(&self) -> bool {
        self.common.overwrite
    }

    /// Where the summary goes, if anywhere.
    pub fn summary_destination(&self) -> Option<Destination> {
        self.common.summary_file.as_deref().map(Destination::from)
    }

    /// Writes the summary, if it was asked for.
    pub fn write_summary(&self, json: &str) -> anyhow::Result<()> {
        match self.summary_destination() {
            Some(destination) => Ok(destination.write(self.common.overwrite, json.as_bytes())?),
            None => Ok(()),
        }
    }
}

/// Writes to standard output; a reader that has gone (as `head` does) is no error.
fn print(bytes: &[u8]) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// Runs the command line; returns the exit code.
pub fn run() -> u8 {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are asked for; everything else is a mistake.
            let _ = error.print();
            return if error.use_stderr() { code::USAGE } else { code::OK };
        }
    };
    // The hook has already told what happened; what is left is to say whose fault it is.
    let result = std::panic::catch_unwind(|| dispatch(cli));
    match result {
        Ok(Ok(code)) => code,
        Ok(Err(error)) => {
            let _ = writeln!(io::stderr(), "{}", failure::message(&error));
            failure::exit_code(&error)
        }
        Err(_) => {
            let _ = writeln!(
                io::stderr(),
                "error: this is a bug in surfcut: please report it, with the command and the input that show it"
            );
            code::INTERNAL
        }
    }
}

fn dispatch(cli: Cli) -> anyhow::Result<u8> {
    if let Some(threads) = cli.common.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global()?;
    }
    let session = Session { bars: Bars::new(cli.common.quiet), common: cli.common };
    if let Some(destination) = session.summary_destination() {
        destination.check(session.overwrite())?;
    }
    if cli.list_gpus {
        backend::list(&session)?;
        return Ok(code::OK);
    }
    let Some(command) = cli.command else {
        // The flags of all commands without one of them.
        let error = Cli::command().error(clap::error::ErrorKind::MissingSubcommand, "say what to do, such as `render`");
        let _ = error.print();
        return Ok(code::USAGE);
    };
    match command {
        Command::Render(args) => render::run(&args, &session),
        Command::Info(args) => info::run(&args, &session),
        Command::Check(args) => check::run(&args, &session),
        Command::Compare(args) => compare::run(&args, &session),
        Command::Chart(args) => chart::run(&args, &session),
        Command::Completions(args) => {
            let mut script = Vec::new();
            clap_complete::generate(args.shell, &mut Cli::command(), "surfcut", &mut script);
            print(&script)?;
            Ok(code::OK)
        }
    }
}
