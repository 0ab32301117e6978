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

use args::{Arguments, Task};
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
        Task::Demo(options) => demo::run(options),
        Task::Ref(options) => feed::run(target, options),
        Task::Goto(options) => feed::go(&target.connect()?, &options.way, |_| options.point),
        Task::Jog(options) => feed::go(&target.connect()?, &options.way, |tip_m| {
            core::array::from_fn(|i| tip_m[i] + options.by[i])
        }),
        Task::Plant(options) => plant::run(target, options),
        Task::Track => request::run(target, RequestKind::Track, None),
        Task::Hold(options) => request::run(target, RequestKind::Hold, options.wait),
        Task::Home(options) => request::run(target, RequestKind::Home, options.wait),
        Task::Stop => request::run(target, RequestKind::Stop, None),
        Task::Reset(options) => reset::run(target, options),
        Task::Top(options) => top::run(target, options),
        Task::Status(options) => show_status::run(target, options),
        Task::Incidents(options) => incidents::run(target, options),
        Task::Settings(options) => settings::run(target, options),
        Task::Echo(options) => echo::run(target, options),
        Task::Hz(options) => hz::run(target, options),
        Task::Plot(options) => plot::run(target, options),
        Task::Record(options) => recording::record::run(target, options),
        Task::Scope(options) => recording::scope::run(target, options),
        Task::Info(options) => recording::info::run(options),
        Task::Report(options) => recording::report::run(options),
        Task::Convert(options) => recording::convert::run(options),
        Task::Replay(options) => recording::replay::run(target, options),
        Task::Obstacle(options) => obstacle::run(target, options),
        Task::Calibrate(options) => calibrate::run(target, options),
    }
}
