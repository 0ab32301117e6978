mod error;
#[cfg(test)]
mod fuzz;

use error::TrajectoryFileProblem as Problem;
pub use error::{TrajectoryFileError, TrajectoryFileProblem};

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use super::{Orientation, Trajectory};

/// Required columns, in any order.
const POSE_COLUMNS: [&str; 4] = ["t_s", "x_m", "y_m", "z_m"];
/// Columns of the orientation: all or none.
const QUATERNION_COLUMNS: [&str; 4] = ["qx", "qy", "qz", "qw"];
/// Largest magnitude of a number: sufficient for seconds since 1970, with a resolution of a microsecond.
const MAGNITUDE_MAX: f64 = 4e9;
/// Tolerance of the length of a quaternion: three decimals are enough.
const UNIT_TOLERANCE: f64 = 2e-3;

/// Size limit: hours at 200 Hz. It protects the memory against endless input.
const BYTES_MAX: u64 = 128_000_000;

fn unread(path: &Path, cause: io::Error) -> TrajectoryFileError {
    TrajectoryFileError {
        path: path.to_owned(),
        line: None,
        problem: Problem::Read(cause),
    }
}

/// A reference read from a CSV file with the header `t_s,x_m,y_m,z_m[,qx,qy,qz,qw]`.
///
/// Its rows are sent unchanged; the daemon interpolates between them. The trajectory starts at the first row,
/// whatever its time.
#[derive(Debug, Clone, PartialEq)]
pub struct FileTrajectory {
    name: String,
    times_s: Vec<f64>,
    positions_m: Vec<[f64; 3]>,
    quaternions: Option<Vec<[f64; 4]>>,
}

/// A problem with its line.
type Located = (Option<u64>, Problem);

fn in_line(line: u64) -> impl FnOnce(Problem) -> Located {
    move |problem| (Some(line), problem)
}

/// One row of the file, checked by itself.
struct FileRow {
    time_s: f64,
    position_m: [f64; 3],
    quaternion: Option<[f64; 4]>,
}

impl FileTrajectory {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// The file, the line and the remedy.
    pub fn read(path: &Path) -> Result<Self, TrajectoryFileError> {
        match File::open(path) {
            Ok(file) => Self::read_from(path, file),
            Err(cause) => Err(unread(path, cause)),
        }
    }

    /// Reads and checks any input, such as the standard input; `path` is used in messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_from(path: &Path, input: impl Read) -> Result<Self, TrajectoryFileError> {
        let mut text = String::new();
        let read = input.take(BYTES_MAX + 1).read_to_string(&mut text);
        match read {
            Ok(count) if count as u64 <= BYTES_MAX => Self::parse(path, &text),
            Ok(_) => Err(unread(path, io::Error::other("it is larger than 128 MB"))),
            Err(cause) => Err(unread(path, cause)),
        }
    }

    /// Checks the text of a file; `path` is used in messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(path: &Path, text: &str) -> Result<Self, TrajectoryFileError> {
        Self::checked(path, text).map_err(|(line, problem)| TrajectoryFileError {
            path: path.to_owned(),
            line,
            problem,
        })
    }

    fn checked(path: &Path, text: &str) -> Result<Self, Located> {
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            // The CSV reader takes a comment at the end of the file for a row if no line break follows.
            .from_reader(text.as_bytes().chain(&b"\n"[..]));
        let header = reader
            .headers()
            .map_err(|error| csv_problem(text, &error))?;
        if header.is_empty() {
            return Err((None, Problem::Empty));
        }
        // No name of a column begins so.
        if text
            .trim_start_matches(['\u{feff}', ' ', '\r', '\n'])
            .starts_with(['{', '['])
        {
            return Err((None, Problem::Json));
        }
        let columns = PointColumns::find(header).map_err(in_line(1))?;
        check_end(text, header)?;
        let mut trajectory = Self {
            name: path.display().to_string(),
            times_s: Vec::new(),
            positions_m: Vec::new(),
            quaternions: columns.quaternion.map(|_| Vec::new()),
        };
        for record in reader.records() {
            let record = record.map_err(|error| csv_problem(text, &error))?;
            let row = columns.row(&record);
            let line = line_of(record.position(), text);
            row.and_then(|row| trajectory.push(&row))
                .map_err(in_line(line))?;
        }
        trajectory.finish().map_err(|problem| (None, problem))
    }

    fn push(&mut self, row: &FileRow) -> Result<(), Problem> {
        if let Some(&previous_s) = self.times_s.last()
            && row.time_s - previous_s < 1e-6
        {
            return Err(Problem::TimeNotIncreasing {
                time_s: row.time_s,
                previous_s,
            });
        }
        self.times_s.push(row.time_s);
        self.positions_m.push(row.position_m);
        if let (Some(all), Some(quaternion)) = (&mut self.quaternions, row.quaternion) {
            all.push(quaternion);
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Self, Problem> {
        let rows = self.times_s.len();
        if rows < 2 {
            return Err(Problem::TooShort(rows));
        }
        let start_s = self.times_s[0];
        for time_s in &mut self.times_s {
            *time_s -= start_s;
        }
        Ok(self)
    }

    /// Index of the row at or before `time_s`, and the fraction towards the next, 0 ..= 1.
    fn locate(&self, time_s: f64) -> (usize, f64) {
        let after = self.times_s.partition_point(|&t| t <= time_s);
        let before = after.saturating_sub(1).min(self.times_s.len() - 2);
        let span_s = self.times_s[before + 1] - self.times_s[before];
        let share = (time_s - self.times_s[before]) / span_s;
        (before, share.clamp(0.0, 1.0))
    }
}

impl Trajectory for FileTrajectory {
    fn name(&self) -> &str {
        &self.name
    }

    fn duration_s(&self) -> f64 {
        self.times_s.last().copied().unwrap_or(0.0)
    }

    /// Linear interpolation between two rows.
    fn position_m(&self, time_s: f64) -> [f64; 3] {
        let (before, share) = self.locate(time_s);
        let (a, b) = (self.positions_m[before], self.positions_m[before + 1]);
        core::array::from_fn(|i| a[i] + share * (b[i] - a[i]))
    }

    /// Orientation of the nearer row.
    fn orientation(&self, time_s: f64) -> Orientation {
        let (before, share) = self.locate(time_s);
        let nearer = before + usize::from(share >= 0.5);
        match &self.quaternions {
            Some(all) => Orientation::Full(all[nearer]),
            None => Orientation::Free,
        }
    }

    fn knots_s(&self) -> Option<&[f64]> {
        Some(&self.times_s)
    }
}

/// Column of each value.
struct PointColumns {
    pose: [usize; 4],
    quaternion: Option<[usize; 4]>,
}

impl PointColumns {
    fn find(header: &csv::StringRecord) -> Result<Self, Problem> {
        check_header(header)?;
        // Spreadsheet programs may write a byte-order mark before the first name.
        let names: Vec<&str> = header
            .iter()
            .map(|name| name.trim_start_matches('\u{feff}'))
            .collect();
        let is_twice = |(index, name): &(usize, &&str)| names[..*index].contains(name);
        let mut named = names
            .iter()
            .enumerate()
            .filter(|(_, name)| !name.is_empty());
        if let Some((_, column)) = named.find(is_twice) {
            return Err(Problem::DuplicateColumn((*column).to_owned()));
        }
        let place = |column: &'static str| names.iter().position(|&name| name == column);
        let find = |columns: [&'static str; 4]| -> Result<[usize; 4], Problem> {
            let mut found = [0; 4];
            for (slot, column) in found.iter_mut().zip(columns) {
                *slot = place(column).ok_or(Problem::MissingColumn(column))?;
            }
            Ok(found)
        };
        let has_quaternion = QUATERNION_COLUMNS.iter().any(|c| place(c).is_some());
        Ok(Self {
            pose: find(POSE_COLUMNS)?,
            quaternion: has_quaternion
                .then(|| find(QUATERNION_COLUMNS))
                .transpose()?,
        })
    }

    fn row(&self, record: &csv::StringRecord) -> Result<FileRow, Problem> {
        let number = |index: usize, column: &'static str| {
            let text = record.get(index).unwrap_or("");
            match text.parse::<f64>() {
                Ok(value) if value.abs() <= MAGNITUDE_MAX => Ok(value),
                _ => Err(Problem::NotANumber {
                    column,
                    text: text.to_owned(),
                }),
            }
        };
        let four = |places: [usize; 4], columns: [&'static str; 4]| {
            let mut values = [0.0; 4];
            for ((value, index), column) in values.iter_mut().zip(places).zip(columns) {
                *value = number(index, column)?;
            }
            Ok(values)
        };
        let [time_s, x, y, z] = four(self.pose, POSE_COLUMNS)?;
        let quaternion = match self.quaternion {
            Some(places) => Some(unit(four(places, QUATERNION_COLUMNS)?)?),
            None => None,
        };
        Ok(FileRow {
            time_s,
            position_m: [x, y, z],
            quaternion,
        })
    }
}

/// Checks that the first line is a header with columns separated by commas.
fn check_header(header: &csv::StringRecord) -> Result<(), Problem> {
    if !header.is_empty() && header.iter().all(|name| name.parse::<f64>().is_ok()) {
        return Err(Problem::NoHeader);
    }
    let mut letters = header.get(0).unwrap_or("").chars();
    let found = letters.find(|letter| [';', '\t', '|', ' '].contains(letter));
    found.map_or(Ok(()), |found| Err(Problem::Separator(found)))
}

/// Refuses an unterminated last line: a file that was cut inside a number still parses.
fn check_end(text: &str, header: &csv::StringRecord) -> Result<(), Located> {
    let last = text.rsplit(['\n', '\r']).next().unwrap_or("").trim();
    if last.is_empty() || last.starts_with('#') {
        return Ok(());
    }
    let columns = last.split(',').count();
    let name = header.get(columns - 1).map(str::to_owned);
    let cell = last.rsplit(',').next().unwrap_or_default();
    let problem = Problem::Cut {
        column: name.unwrap_or_else(|| columns.to_string()),
        text: cell.trim().to_owned(),
    };
    Err((Some(text.lines().count() as u64), problem))
}

/// Normalises a quaternion whose length is 1 within the tolerance.
fn unit(q: [f64; 4]) -> Result<[f64; 4], Problem> {
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if (norm - 1.0).abs() > UNIT_TOLERANCE {
        return Err(Problem::NotUnit(norm));
    }
    Ok(q.map(|x| x / norm))
}

/// Line number of a row. The CSV reader's own number is that of preceding blank lines and comments.
fn line_of(position: Option<&csv::Position>, text: &str) -> u64 {
    let Some(position) = position else { return 1 };
    let rest = text.get(position.byte() as usize..).unwrap_or("");
    let skipped = rest
        .lines()
        .take_while(|line| line.is_empty() || line.starts_with('#'));
    position.line() + skipped.count() as u64
}

fn csv_problem(text: &str, error: &csv::Error) -> Located {
    let cause = match error.kind() {
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => format!("the row has {len} cells, the header {expected_len}"),
        _ => error.to_string(),
    };
    (Some(line_of(error.position(), text)), Problem::Csv(cause))
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_near;
    use super::*;

    fn parse(text: &str) -> Result<FileTrajectory, TrajectoryFileError> {
        FileTrajectory::parse(Path::new("ref.csv"), text)
    }

    fn message(text: &str) -> String {
        parse(text).expect_err("the file is wrong").to_string()
    }

    #[test]
    fn a_good_file_is_followed_row_by_row() {
        let file =
            parse("t_s,x_m,y_m,z_m\n1.0,0,0,0.3\n1.5,0.1,0,0.3\n2,0.1,0.2,0.3\n").expect("good");
        assert_eq!(file.knots_s(), Some(&[0.0, 0.5, 1.0][..]));
        assert_near(file.position_m(0.25), [0.05, 0.0, 0.3]);
        assert_near(file.position_m(9.0), [0.1, 0.2, 0.3]);
        assert_near(file.position_m(-1.0), [0.0, 0.0, 0.3]);
        assert_eq!(file.orientation(0.0), Orientation::Free);
    }

    #[test]
    fn what_never_ends_is_refused() {
        let path = Path::new("endless");
        let refused = FileTrajectory::read_from(path, io::repeat(b'1')).expect_err("too large");
        let refused = refused.to_string();
        assert!(refused.contains("endless: it is larger than"), "{refused}");
    }

    #[test]
    fn orientations_are_read_in_any_column_order() {
        let file = parse("qw,qx,qy,qz,t_s,z_m,y_m,x_m\n1,0,0,0,0,0.3,0,0\n0,1,0,0,1,0.3,0.2,0.1\n")
            .expect("good");
        assert_near(file.position_m(1.0), [0.1, 0.2, 0.3]);
        assert_eq!(
            file.orientation(1.0),
            Orientation::Full([1.0, 0.0, 0.0, 0.0])
        );
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let header = "t_s,x_m,y_m,z_m\n";
        for (text, start) in [
            ("", "ref.csv is empty"),
            ("\n# remark\n", "ref.csv is empty"),
            ("t_s,x_m,z_m\n0,0,0\n", "ref.csv:1: column y_m is missing"),
            (
                "t_s,x_m,y_m,z_m,qx\n0,0,0,0,0\n",
                "ref.csv:1: column qy is missing",
            ),
            (
                "t_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,0.3,1,1,0,0\n",
                "ref.csv:2: the quaternion has length 1.4142",
            ),
            (
                &format!("{header}0,0,0\n"),
                "ref.csv:2: the row has 3 cells",
            ),
            (
                &format!("{header}0,0,0,0.3\n0.1,0,0,0.3\n0.1,0,0,0.3\n"),
                "ref.csv:4: t_s = 0.1",
            ),
        ] {
            let reported = message(text);
            assert!(reported.starts_with(start), "{reported}");
        }
        assert!(message(header).contains("0 rows"));
    }

    #[test]
    fn a_column_that_is_there_twice_is_named() {
        for header in ["t_s,x_m,y_m,z_m,x_m", "x_m,t_s, x_m,y_m,z_m"] {
            let text = message(&format!("{header}\n0,0,0,0,0\n1,0,0,0,0\n"));
            assert_eq!(text, "ref.csv:1: column x_m is given more than once");
        }
    }

    #[test]
    fn json_is_named() {
        let point = r#"{"t_s": 0, "x_m": 0.06, "y_m": 0, "z_m": 0.4}"#;
        let next = point.replace("0,", "1,");
        for json in [format!("[{point}, {next}]\n"), format!("{point}\n{next}\n")] {
            let text = message(&json);
            assert!(
                text.starts_with("ref.csv is JSON; it must be a CSV"),
                "{text}"
            );
        }
    }

    #[test]
    fn bad_numbers_are_shown_with_their_line() {
        let header = "t_s,x_m,y_m,z_m\n0,0,0,0.3\n";
        for bad in ["NaN", "inf", "abc", "", "1e300"] {
            let text = message(&format!("{header}\n# remark\n0.1,0,{bad},0.3\n"));
            assert!(text.starts_with("ref.csv:5: y_m is"), "{text}");
            let windows = format!("{header}0.1,0,{bad},0.3\n").replace('\n', "\r\n");
            let text = message(&windows);
            assert!(text.starts_with("ref.csv:3: y_m is"), "{text}");
        }
    }

    #[test]
    fn a_file_that_is_cut_is_refused_with_line_and_column() {
        let whole = "t_s,x_m,y_m,z_m\n0,0,0,0.3\n# remark\n0.1,0,0,0.295\n0.2,0.001,-0.0125,0.29\n";
        assert!(parse(whole).is_ok());
        assert!(parse(&format!("{whole}# remark")).is_ok());
        let last = whole.rfind("0.2,").expect("there");
        let column = |text: &str| ["t_s", "x_m", "y_m", "z_m"][text.matches(',').count()];
        for end in last + 1..whole.len() {
            let reported = message(&whole[..end]);
            let column = column(&whole[last..end]);
            assert!(
                reported.starts_with(&format!(
                    "ref.csv:5: the file ends within this line, in column {column}"
                )),
                "{end}: {reported}"
            );
        }
        let reported = message("t_s,x_m,y_m,z_m");
        assert!(reported.contains("column z_m, at \"z_m\""), "{reported}");
    }

    #[test]
    fn other_separators_and_a_missing_header_are_named() {
        for (found, reported) in [(';', "';'"), ('\t', "'\\t'"), (' ', "' '")] {
            let text = "t_s,x_m,y_m,z_m\n0,0,0,0.3\n".replace(',', &found.to_string());
            let start = format!("ref.csv:1: columns are separated by {reported}");
            assert!(message(&text).starts_with(&start), "{}", message(&text));
        }
        let reported = message("0,0,0,0.3\n1,0,0,0.3\n");
        assert!(
            reported.starts_with("ref.csv:1: the header is missing"),
            "{reported}"
        );
    }
}
