//! The page that `cdcrctl report` generates from a recording, read as a file and opened in a browser.

use std::fs;
use std::path::Path;
use std::process::Command;

use cdcr_shared_types::codes::RequestKind;
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{Daemon, Program, STALL_TOLERANT, refused};
use serde_json::Value;

use super::play::record_beside;

/// A recording of a robot of the laboratory that tracks beside an obstacle, and its page.
fn page() -> (Daemon, String) {
    let daemon = Daemon::start(STALL_TOLERANT);
    record_beside(&daemon, 1, [0.3, 0.0, 0.5], |connection| {
        // Rejected: no client feeds.
        refused(connection, RequestKind::Track);
    });
    let place = daemon.place();
    place.checked(
        "cdcrctl report run.mcap -o run.html",
        0,
        &["run.html", "cycles"],
    );
    let page = fs::read_to_string(place.folder().join("run.html")).unwrap();
    (daemon, page)
}

/// The JSON block of a page.
fn data(page: &str) -> Value {
    let (_, rest) = page.split_once("id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_page_has_all_that_was_recorded_and_needs_nothing_else() {
    let (daemon, page) = page();
    for word in [
        "src=",
        "@import",
        "fetch(",
        "import(",
        "XMLHttpRequest",
        "url(h",
    ] {
        assert!(!page.contains(word), "{word}");
    }
    // The name of the vector format is not an address.
    let addresses = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!addresses.contains("http://") && !addresses.contains("https://"));
    assert!(page.len() < 1_000_000, "{}", page.len());
    let data = data(&page);
    let info = daemon.place().json("info run.mcap");
    assert_eq!(data["link"], "simulated");
    assert_eq!(data["cycles"], info["channels"]["telemetry"]["messages"]);
    assert_eq!(data["deadline_misses"], info["deadline_misses"]);
    let [mean, max, last] = [0, 1, 2].map(|k| data["error_mm"][k].as_f64().unwrap());
    // A robot that differs from its model.
    assert!(
        0.0 < mean && mean <= max && last <= max && max < 50.0,
        "{mean} {max}"
    );
    let curves = &data["curves"];
    let columns = curves["t_s"].as_array().unwrap().len();
    assert!(columns > 200);
    let length = |list: &Value| list.as_array().unwrap().len();
    for name in ["mode", "misses", "bend_rad", "tip_mm", "reference_mm"] {
        assert_eq!(length(&curves[name]), columns, "{name}");
    }
    let series = curves["series"].as_object().unwrap();
    // Error, measured error, clearance, three latencies; for three sections two rates and three cables each.
    assert_eq!(series.len(), 6 + 6 + 9);
    for (name, ends) in series {
        assert!(
            ends.as_array()
                .unwrap()
                .iter()
                .all(|end| length(end) == columns),
            "{name}"
        );
    }
    assert!(data["least_clearance"]["mm"].as_f64().unwrap() > 0.0);
    assert!(length(&data["scenes"]) > 1, "the obstacle comes, and moves");
    for latency in ["wake", "response"] {
        assert_eq!(data["latencies"][latency]["count"], data["cycles"]);
    }
    let events = data["events"].as_array().unwrap();
    let texts: Vec<_> = events
        .iter()
        .filter_map(|event| event["text"].as_str())
        .collect();
    for begin in [
        "holding",
        "tracking",
        "refused: track",
        "request: track",
        "1 obstacle known",
    ] {
        assert!(
            texts.iter().any(|text| text.starts_with(begin)),
            "{begin}: {texts:?}"
        );
    }
}

#[test]
fn a_page_is_not_made_of_what_is_no_recording_nor_over_what_exists() {
    let (daemon, _) = page();
    let place = daemon.place();
    place.write("empty.mcap", "");
    place.checked("cdcrctl report empty.mcap", 1, &["the file is empty"]);
    assert!(!place.folder().join("empty.html").exists());
    let out = "cdcrctl report run.mcap -o run.mcap";
    place.checked(out, 1, &["is the recording itself"]);
    let again = "cdcrctl report run.mcap -o run.html";
    place.checked(again, 1, &["run.html exists", "another --output"]);
    place.checked("cdcrctl info run.mcap", 0, &["telemetry"]);
}

/// A script of this test that reports the results of the page's own script. These are errors, the sections,
/// the number of colours in the picture of the robot, and the distance of the drawn tip from the recorded
/// one.
const PROBE: &str = r"<script>
// At once: the page is drawn before it is seen.
const paths = document.querySelectorAll('svg path').length;
setTimeout(() => {
  const canvas = document.querySelector('canvas');
  const pixels = new Uint32Array(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  const apart = curves.bend_rad.map((bend, i) => {
    const robot = backbone(bend);
    const tip = robot[robot.length - 1][16].p;
    return Math.hypot(...tip.map((mm, k) => mm - curves.tip_mm[i][k]));
  });
  const places = (selector) => [...document.querySelector(selector).getAttribute('d').matchAll(/([ML])\S+ (\d+\.\d)/g)];
  const ys = places('#error svg path').map(([, , y]) => Number(y));
  const reported = {
    references: places('#path svg path').filter(([, begin]) => begin === 'M').length,
    at_the_bottom: ys.filter((y) => y >= 154).length / ys.length,
    errors, sections: [...document.querySelectorAll('section')].map((one) => one.id),
    empty: [...document.querySelectorAll('section')].filter((one) => one.offsetHeight < 40).map((one) => one.id),
    colours: new Set(pixels).size, apart_mm: Math.max(...apart), curves: paths,
  };
  document.body.replaceChildren(JSON.stringify(reported));
}, 1500);
</script></body>";
const WATCH: &str = "<head><script>const errors = []; addEventListener('error', (event) => errors.push(event.message));</script>";

#[test]
fn a_browser_draws_the_page_without_an_error() {
    let browser = "chromium";
    if Command::new(browser).arg("--version").output().is_err() {
        skip(Need::Chromium, format!("there is no {browser}"));
        return;
    }
    let (daemon, page) = page();
    let folder = daemon.place().folder();
    let probed = interrupted(&page)
        .replacen("<head>", WATCH, 1)
        .replacen("</body>", PROBE, 1);
    let path = daemon.place().write("probed.html", &probed);
    let reported = in_browser(browser, folder, &path);
    assert_eq!(reported["errors"], Value::Array(Vec::new()), "{reported}");
    let sections = [
        "summary",
        "robot",
        "path",
        "error",
        "clearance",
        "controls",
        "cables",
        "latencies",
        "events",
        "misses",
    ];
    assert_eq!(reported["sections"], serde_json::json!(sections));
    assert_eq!(reported["empty"], Value::Array(Vec::new()), "{reported}");
    assert!(reported["colours"].as_u64().unwrap() > 50, "{reported}");
    assert!(
        reported["curves"].as_u64().unwrap() >= 6 + 2 + 6 + 9 + 2,
        "{reported}"
    );
    assert_eq!(reported["references"], 2, "{reported}");
    // Values far below the largest error are still distinguishable.
    assert!(
        reported["at_the_bottom"].as_f64().unwrap() < 0.1,
        "{reported}"
    );
    // The tip computed from measured bends: the true one differs, because the offset is unknown here. Numbers
    // have five digits.
    assert!(reported["apart_mm"].as_f64().unwrap() < 0.2, "{reported}");
}

/// The page of a robot whose reference ended and began again, the first time far away.
fn interrupted(page: &str) -> String {
    let (head, rest) = page.split_once("id=\"data\">").unwrap();
    let (_, tail) = rest.split_once("</script>").unwrap();
    let mut data = data(page);
    let curves = &mut data["curves"];
    let references = curves["reference_mm"].as_array_mut().unwrap();
    let mut led = (0..references.len()).filter(|k| !references[*k][0].is_null());
    let (first, middle) = (
        led.next().unwrap(),
        led.nth(led.clone().count() / 2).unwrap(),
    );
    references[middle] = Value::Array(vec![Value::Null; 3]);
    let errors = curves["series"]["error_mm"].as_array_mut().unwrap();
    for end in errors {
        end[first] = 1000.into();
    }
    format!("{head}id=\"data\">{data}</script>{tail}")
}

/// Results of a page after its scripts have run.
fn in_browser(browser: &str, folder: &Path, page: &Path) -> Value {
    // Beside loops of ordinary priority.
    let mut command = Command::new("nice");
    command.args(["-n", "19", browser]);
    command.args([
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
    ]);
    command.args([
        "--virtual-time-budget=10000",
        "--window-size=1100,900",
        "--dump-dom",
    ]);
    command.arg(format!(
        "--user-data-dir={}",
        folder.join("browser").display()
    ));
    command
        .env("HOME", folder)
        .arg(format!("file://{}", page.display()));
    let output = Program::start(&mut command).output();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let json = printed
        .split_once("<body>")
        .and_then(|(_, rest)| rest.split_once("</body>"));
    let (json, _) = json.unwrap_or_else(|| panic!("no page: {}", cdcr_tests::text(&output)));
    serde_json::from_str(json).unwrap_or_else(|cause| panic!("{cause}: {json}"))
}
