use std::io::Read;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use cdcr_client::{FileTrajectory, Orientation, Trajectory, counted};
use cdcr_controller::calibration::{CalibrationRow, behind_play};
use cdcr_controller::robot::{CABLES_MAX, RobotParameters};
use nalgebra::{Quaternion, UnitQuaternion};

/// Largest magnitude of a length: a larger one has another unit.
const MAGNITUDE_MAX: f64 = 4e9;

/// Lengths of rows that exceed the robot's by more than this factor are in another unit. A sensor may be far away.
const UNIT_FACTOR: f64 = 100.0;

/// Header of a recording of a robot with this number of cables.
pub(super) fn header(cables: usize) -> Vec<String> {
    let cables = (1..=cables).map(|cable| format!("cable_{cable}_m"));
    let tip = ["x_m", "y_m", "z_m"].map(str::to_owned);
    let time = ["t_s".to_owned()];
    time.into_iter().chain(cables).chain(tip).collect()
}

/// A file of measured cables and tips.
#[derive(Debug)]
pub(super) struct CalibrationRows {
    pub(super) rows: Vec<CalibrationRow>,
    /// Time from the first row to the last \[s\].
    pub(super) duration_s: f64,
    /// Play between the motors that were measured and the cables of the rows \[m\].
    pub(super) play_m: f64,
}

impl CalibrationRows {
    /// Fails if most rows have lengths that a robot of this size cannot have in m.
    pub(super) fn check_units(&self, robot: &RobotParameters) -> anyhow::Result<()> {
        let reach_m: f64 = robot.sections.iter().map(|section| section.length_m).sum();
        let cables = 3 * robot.sections.len();
        let cable_m = |row: &CalibrationRow| {
            row.cable_length_m[..cables]
                .iter()
                .fold(0.0, |most: f64, m| most.max(m.abs()))
        };
        let tip_m = |row: &CalibrationRow| row.tip_position_m.norm();
        let check = |what: &str, length_m: &dyn Fn(&CalibrationRow) -> f64| {
            let mut lengths_m = self
                .rows
                .iter()
                .map(length_m)
                .filter(|m| *m > UNIT_FACTOR * reach_m);
            let Some(first_m) = lengths_m.next() else {
                return Ok(());
            };
            ensure!(
                2 * (1 + lengths_m.count()) <= self.rows.len(),
                "most rows have a {what} of more than {UNIT_FACTOR:.0} robot lengths ({first_m:.1} m of {reach_m:.3} m): are these millimetres? Columns are in m"
            );
            Ok(())
        };
        check("cable", &cable_m)?;
        check("distance of the tip", &tip_m)
    }

    /// The same with the lengths of the cables behind their play.
    pub(super) fn behind_play(self, play_m: f64) -> Self {
        Self {
            rows: behind_play(&self.rows, play_m),
            play_m,
            ..self
        }
    }

    /// Parses and checks the text of a file of a robot with this number of cables. Times and tips have the
    /// columns of a reference file, with the cables beside them.
    pub(super) fn parse(path: &Path, text: &str, cables: usize) -> anyhow::Result<Self> {
        let cables_m = cables_m(path, text, cables)?;
        let tips = FileTrajectory::parse(path, text)?;
        let times_s = tips.knots_s().unwrap_or_default();
        let row = |(cable_length_m, time_s): ([f64; CABLES_MAX], &f64)| CalibrationRow {
            cable_length_m,
            tip_position_m: tips.position_m(*time_s).into(),
            tip_rotation: match tips.orientation(*time_s) {
                Orientation::Full([x, y, z, w]) => {
                    Some(UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
                }
                _ => None,
            },
        };
        Ok(Self {
            rows: cables_m.into_iter().zip(times_s).map(row).collect(),
            duration_s: tips.duration_s(),
            play_m: 0.0,
        })
    }
}

/// The cables of each row \[m\].
fn cables_m(path: &Path, text: &str, cables: usize) -> anyhow::Result<Vec<[f64; CABLES_MAX]>> {
    let name = path.display();
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        // The CSV reader takes a comment at the end of the file for a row if no line break follows.
        .from_reader(text.as_bytes().chain(&b"\n"[..]));
    let header = reader.headers().with_context(|| name.to_string())?;
    let names = header
        .iter()
        .map(|name| name.trim_start_matches('\u{feff}'));
    let names: Vec<String> = names.map(str::to_owned).collect();
    let columns = cable_columns(&names, cables).with_context(|| format!("{name}:1"))?;
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.with_context(|| name.to_string())?;
        let mut row_m = [0.0; CABLES_MAX];
        for (length_m, column) in row_m.iter_mut().zip(&columns) {
            let text = record.get(*column).unwrap_or("");
            let number = text.parse::<f64>().ok();
            let number = number.filter(|m| m.abs() <= MAGNITUDE_MAX);
            *length_m = number.with_context(|| {
                let (line, column) = (
                    record.position().map_or(0, csv::Position::line),
                    &names[*column],
                );
                format!("{name}:{line}: {column} is {text:?}; it must be a finite number")
            })?;
        }
        rows.push(row_m);
    }
    Ok(rows)
}

/// Column of each cable.
fn cable_columns(names: &[String], cables: usize) -> anyhow::Result<Vec<usize>> {
    let found = names.iter().filter(|name| name.starts_with("cable_"));
    let found = found.count();
    if found > 0 && found != cables {
        bail!(
            "{} of cables, but the configured robot has {cables}, three for each section",
            counted(found, "column")
        );
    }
    let place = |cable: usize| {
        let column = format!("cable_{cable}_m");
        let place = names.iter().position(|name| *name == column);
        place.with_context(|| {
            let header = header(cables).join(",");
            format!("column {column} is missing; the header is {header}[,qx,qy,qz,qw]")
        })
    };
    (1..=cables).map(place).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn parse(text: &str) -> anyhow::Result<CalibrationRows> {
        CalibrationRows::parse(Path::new("a.csv"), text, 3)
    }

    #[test]
    fn rows_are_read_in_any_order_of_columns() {
        let text = "x_m,y_m,z_m,t_s,cable_1_m,cable_2_m,cable_3_m,qx,qy,qz,qw\n\
            # by hand\n0.1,0.2,0.3,1.5,0.31,0.32,0.33,0,0,0,1\n1,2,3,2,0.4,0.5,0.6,0,0,1,0\n";
        let recording = parse(text).expect("good");
        assert_eq!(recording.duration_s, 0.5);
        let row = &recording.rows[0];
        assert_eq!(row.cable_length_m[..4], [0.31, 0.32, 0.33, 0.0]);
        assert_eq!(row.tip_position_m, Vector3::new(0.1, 0.2, 0.3));
        assert_eq!(row.tip_rotation, Some(UnitQuaternion::identity()));
    }

    #[test]
    fn millimetres_are_named_and_a_stray_row_is_not() {
        let robot = RobotParameters::paper(1);
        let checked = |cable: f64, tips: [f64; 3]| {
            let [a, b, c] = tips;
            let text = format!(
                "t_s,cable_1_m,cable_2_m,cable_3_m,x_m,y_m,z_m\n0,{cable},0.3,0.3,0,0,{a}\n1,{cable},0.3,0.3,0,0,{b}\n2,{cable},0.3,0.3,0,0,{c}\n"
            );
            let checked = parse(&text).expect("good").check_units(&robot);
            checked
                .map_err(|error| error.to_string())
                .err()
                .unwrap_or_default()
        };
        assert_eq!(checked(0.3, [0.3, 0.29, 5000.0]), "");
        let error = checked(0.3, [300.0, 0.29, 290.0]);
        assert!(
            error.contains("distance of the tip of more than 100 robot lengths (300.0 m")
                && error.contains("millimetres"),
            "{error}"
        );
        let error = checked(310.0, [0.3, 0.29, 0.28]);
        assert!(
            error.contains("a cable of more than 100 robot lengths (310.0 m"),
            "{error}"
        );
    }

    #[test]
    fn an_error_has_line_and_column() {
        const HEADER: &str = "t_s,cable_1_m,cable_2_m,cable_3_m,x_m,y_m,z_m";
        for (text, words) in [
            (
                format!("{HEADER}\n0,1,1,1,0,0,0\n1,1,nan,1,0,0,0\n"),
                "a.csv:3: cable_2_m is \"nan\"",
            ),
            (
                format!("{HEADER}\n0,1,1,1,0,0\n"),
                "found record with 6 fields",
            ),
            (
                format!("{HEADER}\n1,1,1,1,0,0,0\n1,1,1,1,0,0,0\n"),
                "a.csv:3: t_s = 1 is not after 1",
            ),
            (format!("{HEADER},qx\n"), "column qy is missing"),
            (
                format!("{HEADER},qx,qy,qz,qw\n0,1,1,1,0,0,0,0,0,0,2\n"),
                "length 2.0000",
            ),
            (
                "t_s,cable_1_m,x_m,y_m,z_m\n".to_owned(),
                "1 column of cables, but the configured robot has 3",
            ),
            (
                "t_s,x_m,y_m,z_m\n".to_owned(),
                "column cable_1_m is missing; the header is t_s,cable_1_m",
            ),
        ] {
            let error = format!("{:#}", parse(&text).expect_err("it is wrong"));
            assert!(error.contains(words), "{error}");
        }
    }
}
