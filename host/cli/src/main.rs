//! `r4`: drives R4 boards, real and simulated.

mod args;
mod choice;
mod commands;
mod emulated;
mod failure;
mod known;
mod live;
mod output;
mod plants;
mod record;
mod report;
mod screen;
mod session;
mod table;
mod verbs;

use std::{env, process::ExitCode};

use anyhow::Context;
use clap::CommandFactory;
use r4_protocol::Mode;

use args::Args;
use commands::identify::NotExplained;
use output::OutputError;
use verbs::{Command, Sim, Typed};

fn main() -> ExitCode {
    commands::completions::answer(Typed::command);
    let Typed { args, command } = match Typed::from_command_line() {
        Ok(typed) => typed,
        // A usage error leaves `--json` unparsed: look for it in the words.
        Err(error) => return failure::report_usage(&error, env::args_os().any(|typed| typed == "--json")),
    };
    let result = choice::check(&args, &command)
        .map_err(Into::into)
        .and_then(|()| check_physics(&args, &command))
        .and_then(|()| run(&args, &command));
    match result {
        Ok(_) if args.record.is_some() && !record::is_recorded() => {
            eprintln!("r4: nothing was recorded: this command opens no session with a board");
            ExitCode::FAILURE
        }
        Ok(_) if !session::has_physics_as_asked(&args) => {
            eprintln!(
                "r4: --plant, --body and --blind had no effect: this command starts no simulated board of its own"
            );
            ExitCode::FAILURE
        }
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        // A closed pipe means that the reader has seen enough, as with `head`.
        Err(error) if error.downcast_ref::<OutputError>().is_some_and(OutputError::is_closed_pipe) => ExitCode::FAILURE,
        // Ctrl-C is the usual end of these commands.
        Err(error)
            if session::was_interrupted(&error)
                && matches!(
                    command,
                    Command::Watch(_)
                        | Command::Monitor(_)
                        | Command::Ros2(_)
                        | Command::Serve(_)
                        | Command::Sim { .. }
                ) =>
        {
            ExitCode::SUCCESS
        }
        Err(error) if error.is::<NotExplained>() => {
            eprintln!("r4: {error}");
            ExitCode::from(NOT_EXPLAINED)
        }
        Err(error) => failure::report(&args, &error),
    }
}

/// Exit code of an identification that explains nothing: a result rather than a failure.
const NOT_EXPLAINED: u8 = 6;

/// Refuses options for other physics on a board at the other end of a link.
fn check_physics(args: &Args, command: &Command) -> anyhow::Result<()> {
    let is_served = matches!(command, Command::Sim { .. } | Command::Identify(_));
    if let (true, false, session::Target::Link(_)) = (args.asks_for_physics(), is_served, &args.board) {
        args.board.robot().context("--plant, --body and --blind change the physics of a simulated board")?;
    }
    Ok(())
}

/// Runs a command; false if it ran but missed its result, for exit code 1.
fn run(args: &Args, command: &Command) -> anyhow::Result<bool> {
    match command {
        Command::Demo(demo) => commands::demo::run(args, demo),
        Command::Info => commands::info::run(args),
        Command::Arm { seconds } => commands::state::arm(args, *seconds),
        Command::Disarm => commands::state::disarm(args),
        Command::Clear => commands::state::clear(args),
        Command::Step(step) => commands::motion::step(args, step),
        Command::Home(home) => commands::motion::home(args, home),
        Command::Follow { file } => commands::follow::run(args, file),
        Command::Move(motion) => commands::motion::run(args, motion, Mode::Position),
        Command::Speed(motion) => commands::motion::run(args, motion, Mode::Speed),
        Command::Duty(motion) => commands::motion::run(args, motion, Mode::Duty),
        Command::Press(motion) => commands::motion::run(args, motion, Mode::Force),
        Command::Relay(relay) => commands::relay::run(args, relay),
        Command::Servo(servo) => commands::hold::servo(args, servo),
        Command::Bldc(bldc) => commands::hold::bldc(args, bldc),
        Command::Dac(dac) => commands::hold::dac(args, dac),
        Command::Calibrate(calibrate) => commands::calibrate::run(args, calibrate),
        Command::Config(config) => commands::config::run(args, config),
        Command::Faults { index } => commands::faults::run(args, *index),
        Command::Flash(flash) => commands::flash::run(args, flash),
        Command::I2c(i2c) => commands::raw::i2c(args, i2c),
        Command::Uart(uart) => commands::raw::uart(args, uart),
        Command::Tune(tune) => commands::tune::run(args, tune),
        Command::Watch(watch) => commands::watch::run(args, watch),
        Command::Monitor(monitor) => commands::monitor::run(args, monitor),
        Command::Drive(drive) => commands::drive::run(args, drive),
        Command::Scenario(scenario) => commands::scenario::run(args, scenario),
        Command::Debug(debug) => commands::debug::run(args, debug),
        Command::Bridge { what } => commands::bridge::run(args, what),
        Command::Ros2(ros2) => commands::ros2::run(args, ros2),
        Command::Log(log) => commands::log::run(args, log),
        Command::Report(report) => commands::report::run(args, report),
        Command::Identify(identify) => commands::identify::run(args, identify),
        Command::System { what } => commands::system::run(args, what),
        Command::Evaluate { what } => commands::evaluate::run(args, what),
        Command::Ports => commands::ports::run(args),
        Command::Access { what } => commands::access::run(args, what),
        Command::Serve(share) => commands::share::run(args, share),
        Command::Sim { what: Sim::Serve(serve) } => commands::serve::run(args, serve),
        Command::Sim { what: Sim::Reveal(reveal) } => commands::reveal::run(args, reveal),
        Command::Bench { what } => commands::bench::run(args, what),
        Command::Completions(completions) => commands::completions::run(completions),
        Command::Man(manual) => commands::man::run(manual, Typed::command()),
    }
}
