//! `cdcrctl`: feeds references to `cdcrd`, sends requests and shows its state.
//!
//! Based on the library `cdcr_client`: this program adds only command lines, texts, tables and pictures.

#![forbid(unsafe_code)]
#![deny(clippy::print_stderr)]

#[macro_use]
mod tell;

mod args;
mod backbone;
mod bar;
mod bend_limit;
mod calibrate;
mod demo;
mod done;
mod dry_run;
mod echo;
mod feed;
mod files;
mod hz;
mod incidents;
mod interrupt;
mod keys;
mod known_obstacles;
mod obstacle;
mod obstacle_in_way;
mod picture;
mod plant;
mod plot;
mod reach;
mod recording;
mod request;
mod reset;
mod setting;
mod settings;
mod shape_choice;
mod show_status;
mod spread;
mod standing;
mod standstill;
mod stop_cause;
mod tip_error;
mod top;
mod trigger;
mod unmeasured_tip;
mod value;
mod wait;
mod way_end;

use std::process::ExitCode;

use cdcr_shared_types::codes::RequestKind;
use clap::Parser;
use iceoryx2::prelude::{LogLevel, set_log_level};

use args::{Arguments, CtlCommand};
use done::{Done, exit_code};

fn main() -> ExitCode {
    // This program reports the errors itself, so iceoryx2's log is turned off.
    set_log_level(LogLevel::Fatal);
    args::complete::answer();
    let arguments = Arguments::parse();
    let code = exit_code(run(&arguments));
    tell::finish();
    code
}

fn run(arguments: &Arguments) -> anyhow::Result<Done> {
    let target = &arguments.target;
    match &arguments.task {
        CtlCommand::Demo(options) => demo::run(options),
        CtlCommand::Ref(options) => feed::run(target, options),
        CtlCommand::Goto(options) => feed::go(&target.connect()?, &options.way, |_| options.point),
        CtlCommand::Jog(options) => feed::go(&target.connect()?, &options.way, |tip_m| {
            core::array::from_fn(|i| tip_m[i] + options.by[i])
        }),
        CtlCommand::Plant(options) => plant::run(target, options),
        CtlCommand::Track => request::run(target, RequestKind::Track, None),
        CtlCommand::Hold(options) => request::run(target, RequestKind::Hold, options.wait),
        CtlCommand::Home(options) => request::run(target, RequestKind::Home, options.wait),
        CtlCommand::Stop => request::run(target, RequestKind::Stop, None),
        CtlCommand::Reset(options) => reset::run(target, options),
        CtlCommand::Top(options) => top::run(target, options),
        CtlCommand::Status(options) => show_status::run(target, options),
        CtlCommand::Incidents(options) => incidents::run(target, options),
        CtlCommand::Settings(options) => settings::run(target, options),
        CtlCommand::Echo(options) => echo::run(target, options),
        CtlCommand::Hz(options) => hz::run(target, options),
        CtlCommand::Plot(options) => plot::run(target, options),
        CtlCommand::Record(options) => recording::record::run(target, options),
        CtlCommand::Scope(options) => recording::scope::run(target, options),
        CtlCommand::Info(options) => recording::info::run(options),
        CtlCommand::Report(options) => recording::report::run(options),
        CtlCommand::Convert(options) => recording::convert::run(options),
        CtlCommand::Replay(options) => recording::replay::run(target, options),
        CtlCommand::Obstacle(options) => obstacle::run(target, options),
        CtlCommand::Calibrate(options) => calibrate::run(target, options),
    }
}
