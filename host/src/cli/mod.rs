//! The verbs of the `windlass` command.

mod connect;
pub mod demo;
mod failure;
mod faults;
mod flash;
mod id;
mod image;
mod info;
mod interrupt;
mod monitor;
pub mod output;
mod param;
mod progress;
mod run;
mod sample;
mod scan;
pub mod sim;
mod talon;
mod test;

use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

pub use failure::{Failure, Kind, Outcome};
pub use interrupt::interrupted;

/// Exit codes, as `--help` shows them; `docs/command.md` explains each.
const EXIT_CODES: &str = "Exit codes: 0 done, 1 unexpected failure, 2 wrong usage, 3 transport or bus failed, \
4 no such device, 5 device did not answer, 6 device refused or value out of range, \
7 self-test failed or fault reported, 8 file unusable, 130 interrupted.";

/// Bench and tool for CAN motor controllers. Without a verb it runs `demo`.
#[derive(Debug, Parser)]
#[command(name = "windlass", version, after_help = EXIT_CODES)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    verb: Option<Verb>,
}

/// Options that every verb takes.
#[derive(Clone, Debug, Args)]
pub struct Global {
    /// The bus: `sim`, `slcan:DEVICE[@BITRATE]`, `tcp:HOST:PORT` or `socketcan:INTERFACE`.
    #[arg(
        long,
        short,
        value_name = "TRANSPORT",
        env = "WINDLASS_TRANSPORT",
        default_value = "sim",
        global = true
    )]
    pub transport: String,
    /// Print one JSON document, or one JSON line for each sample of a live verb.
    #[arg(long, global = true)]
    pub json: bool,
    /// Wait this many milliseconds for each answer of a device.
    #[arg(
        long,
        value_name = "MS",
        default_value_t = 100,
        value_parser = clap::value_parser!(u64).range(1..=60_000),
        global = true
    )]
    pub timeout: u64,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// List the devices on the bus.
    Scan(scan::Arguments),
    /// Show names, versions and flash wear of devices.
    Info(info::Arguments),
    /// Make a device blink, or give it a number or a name.
    Id(id::Arguments),
    /// Test devices and print a report; nothing moves.
    Test(test::Arguments),
    /// Read and write parameters.
    Param(param::Arguments),
    /// Drive a device, then switch it off.
    Run(run::Arguments),
    /// Watch the status of devices and the load of the bus.
    Monitor(monitor::Arguments),
    /// Show and clear faults.
    Faults(faults::Arguments),
    /// Update the firmware of devices.
    Flash(flash::Arguments),
    /// Look at firmware files, seal and sign them.
    Image(image::Arguments),
    /// Spin a simulated motor and show how to connect to the bench.
    Demo(demo::Arguments),
    /// Serve the virtual bench: SLCAN on TCP and on a pty, HTTP with JSON API and web page.
    Sim(sim::Arguments),
}

impl Verb {
    /// True for the verbs that run until they see the flag of Ctrl-C and then clean up.
    const fn ends_by_flag(&self) -> bool {
        matches!(
            self,
            Self::Run(_) | Self::Monitor(_) | Self::Flash(_) | Self::Demo(_) | Self::Sim(_)
        )
    }
}

/// Parses the command line, runs the verb and gives the exit code.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let global = cli.global;
    let verb = cli
        .verb
        .unwrap_or_else(|| Verb::Demo(demo::Arguments::default()));
    match interrupt::install(verb.ends_by_flag()).and_then(|()| dispatch(&verb, &global)) {
        Ok(outcome) => ExitCode::from(outcome.code()),
        Err(failure) => failure::report(&failure, global.json),
    }
}

fn dispatch(verb: &Verb, global: &Global) -> Result<Outcome, Failure> {
    match verb {
        Verb::Scan(arguments) => scan::run(arguments, global),
        Verb::Info(arguments) => info::run(arguments, global),
        Verb::Id(arguments) => id::run(arguments, global),
        Verb::Test(arguments) => test::run(arguments, global),
        Verb::Param(arguments) => param::run(arguments, global),
        Verb::Run(arguments) => run::run(arguments, global),
        Verb::Monitor(arguments) => monitor::run(arguments, global),
        Verb::Faults(arguments) => faults::run(arguments, global),
        Verb::Flash(arguments) => flash::run(arguments, global),
        Verb::Image(arguments) => image::run(arguments, global),
        Verb::Demo(arguments) => demo::run(arguments, global),
        Verb::Sim(arguments) => sim::run(arguments, global),
    }
}

/// Prints help or version as asked, or turns clap's error into this command's form.
fn usage(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() {
        return match error.print() {
            Ok(()) => ExitCode::SUCCESS,
            Err(_) => ExitCode::FAILURE,
        };
    }
    let text = error.to_string();
    let json = std::env::args().any(|argument| argument == "--json");
    failure::report(&usage_failure(&text), json)
}

/// The first paragraph of clap's message is the error; tips and the usage line are the next step.
fn usage_failure(text: &str) -> Failure {
    let mut paragraphs = text.split("\n\n");
    let message = joined_lines(paragraphs.next().unwrap_or_default());
    let next: Vec<String> = paragraphs.map(joined_lines).collect();
    Failure::new(
        Kind::Usage,
        message.trim_start_matches("error: "),
        next.join("; "),
    )
}

fn joined_lines(paragraph: &str) -> String {
    let lines: Vec<&str> = paragraph.lines().map(str::trim).collect();
    lines.join(" ").trim().to_owned()
}
