//! docs/calibration.md from start to end: its commands, as they stand there, with a real daemon and a robot that is not what it is
//! configured to be.

use std::path::Path;

use cdcr_scratch::Scratch;
use cdcr_tests::{Daemon, Place, text};
use serde_json::Value;

const PAGE: &str = include_str!("../../../../docs/calibration.md");

/// The blocks of the page in this language.
fn blocks(language: &str) -> Vec<&'static str> {
    let begin = format!("```{language}\n");
    let parts = PAGE.split(&begin).skip(1);
    parts
        .map(|part| part.split("```").next().unwrap())
        .collect()
}

/// The commands of the page, in order; `shorter` by this factor, and then only those before the paste.
fn commands(shorter: Option<u32>) -> Vec<Vec<String>> {
    let lines = blocks("console").into_iter().flat_map(str::lines);
    let lines = lines.filter_map(|line| line.strip_prefix("$ "));
    let commands = lines.map(|line| line.split_whitespace().map(str::to_owned).collect());
    let Some(factor) = shorter else {
        return commands.collect();
    };
    let mut commands: Vec<Vec<String>> = commands.collect();
    let is_geometry = |command: &Vec<String>| command.iter().any(|word| word == "geometry");
    let end = commands.iter().position(is_geometry).unwrap();
    commands.truncate(end + 1);
    for word in commands.iter_mut().flatten() {
        let seconds = word.strip_suffix('s').and_then(|s| s.parse::<u32>().ok());
        if let Some(seconds) = seconds {
            *word = format!("{}ms", 1000 * seconds / factor);
        }
    }
    commands
}

fn run(place: &Place, folder: &Path, arguments: &[&str]) -> String {
    let output = place
        .command("cdcrctl")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", text(&output));
    text(&output)
}

/// Moves the robot along a reference; again where a busy machine kept its points from the daemon for too long.
fn move_along(place: &Place, folder: &Path, arguments: &[&str]) {
    let mut tries = (0..3).map(|_| {
        let mut command = place.command("cdcrctl");
        let output = command
            .args(arguments)
            .current_dir(folder)
            .output()
            .unwrap();
        let is_late = text(&output).contains("came too late");
        assert!(output.status.success() || is_late, "{}", text(&output));
        output.status.success()
    });
    assert!(
        tries.any(|is_good| is_good),
        "{arguments:?}: late each time"
    );
}

/// What a recording says, as JSON, of the robot of a daemon.
fn geometry(place: &Place, folder: &Path, file: &str) -> Value {
    let arguments = ["calibrate", "geometry", file, "--format", "json"];
    serde_json::from_str(&run(place, folder, &arguments)).unwrap()
}

fn rms_mm(found: &Value, robot: &str) -> f64 {
    1e3 * found["tip_error"][robot]["rms_m"].as_f64().unwrap()
}

#[test]
fn the_page_finds_the_robot_and_its_paste_makes_the_error_small() {
    let folder = Scratch::temporary().unwrap();
    let folder = folder.path();
    let mut recorder = None;
    let mut configuration = blocks("toml")[0].to_owned();
    let (mut daemon, mut printed, mut errors_mm) = (None::<Daemon>, String::new(), Vec::new());
    // Three minutes; the half of it, three times as fast, without.
    let is_whole = std::env::var_os("CDCR_CALIBRATION_WHOLE").is_some();
    if !is_whole {
        configuration += "\n[motion]\napproach_speed_m_s = 0.5\napproach_acceleration_m_s2 = 2.0\n";
    }
    for command in commands((!is_whole).then_some(3)) {
        let command: Vec<&str> = command.iter().map(String::as_str).collect();
        match command[..] {
            ["cdcrd", "run", ..] => {
                if let Some(mut before) = daemon.take() {
                    // Between the two the page has the paste.
                    assert_eq!(before.stop().code(), Some(0));
                    let sections = printed.split("# Instead of").nth(1).unwrap();
                    configuration = [configuration.as_str(), "\n# Instead of", sections].concat();
                }
                daemon = Some(Daemon::start(&configuration));
            }
            ["cdcrctl", ref arguments @ .., "&"] => {
                let place = daemon.as_ref().unwrap().place();
                let mut command = place.command("cdcrctl");
                recorder = Some(command.args(arguments).current_dir(folder).spawn().unwrap());
            }
            ["cdcrctl", ref arguments @ ..] if arguments[0] == "ref" => {
                let place = daemon.as_ref().unwrap().place();
                move_along(place, folder, arguments);
            }
            ["wait"] => assert!(recorder.take().unwrap().wait().unwrap().success()),
            ["cdcrctl", ref arguments @ ..] => {
                let place = daemon.as_ref().unwrap().place();
                printed = run(place, folder, arguments);
                if let ["calibrate", "geometry", file, ..] = arguments {
                    let found = geometry(place, folder, file);
                    errors_mm.push((
                        rms_mm(&found, "configured_held_out"),
                        rms_mm(&found, "found_held_out"),
                    ));
                }
            }
            _ => panic!("{command:?}"),
        }
    }
    // Before and after the paste: with the configuration as it was then, and with what was found.
    println!("held out, configured and found: {errors_mm:?} mm");
    let before = errors_mm[0];
    assert!(before.0 > 15.0 && before.1 < 2.0, "{errors_mm:?}");
    assert_eq!(errors_mm.len(), if is_whole { 2 } else { 1 });
    if let Some(after) = errors_mm.get(1) {
        assert!(after.0 < 0.2 * before.0, "{errors_mm:?}");
    }
}
