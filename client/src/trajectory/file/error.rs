use std::fmt;
use std::path::PathBuf;

use super::MAGNITUDE_MAX;

/// Problem in a reference file, with its location.
#[derive(Debug)]
pub struct TrajectoryFileError {
    /// The reference file as it was named.
    pub path: PathBuf,
    /// Number of the line, from 1; `None` for the whole file.
    pub line: Option<u64>,
    /// What is wrong there.
    pub problem: TrajectoryFileProblem,
}

impl fmt::Display for TrajectoryFileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (path, problem) = (self.path.display(), &self.problem);
        match (self.line, problem) {
            (Some(line), _) => write!(f, "{path}:{line}: {problem}"),
            (None, TrajectoryFileProblem::Read(cause)) => write!(
                f,
                "cannot read {path}: {cause}; it must be a CSV file with the columns t_s,x_m,y_m,z_m or \
                 t_s,x_m,y_m,z_m,qx,qy,qz,qw"
            ),
            (None, _) => write!(f, "{path} {problem}"),
        }
    }
}

impl core::error::Error for TrajectoryFileError {}

/// Kind of problem in a reference file.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryFileProblem {
    /// The file cannot be read.
    #[error("{0}")]
    Read(std::io::Error),
    /// The file is not valid CSV.
    #[error("{0}")]
    Csv(String),
    /// The file has no line but comments.
    #[error("is empty; it needs the header t_s,x_m,y_m,z_m and at least 2 rows")]
    Empty,
    /// The file is JSON.
    #[error(
        "is JSON; it must be a CSV file with the columns t_s,x_m,y_m,z_m or t_s,x_m,y_m,z_m,qx,qy,qz,qw"
    )]
    Json,
    /// This column is missing in the header.
    #[error("column {0} is missing; the header is t_s,x_m,y_m,z_m or t_s,x_m,y_m,z_m,qx,qy,qz,qw")]
    MissingColumn(&'static str),
    /// The first line is not a header.
    #[error(
        "the header is missing: the first line contains numbers; add the header t_s,x_m,y_m,z_m or \
         t_s,x_m,y_m,z_m,qx,qy,qz,qw"
    )]
    NoHeader,
    /// Columns are separated by this character instead of a comma.
    #[error("columns are separated by {0:?}: use commas, and decimal points (0.9, not 0,9)")]
    Separator(char),
    /// The last line has no line break.
    #[error(
        "the file ends within this line, in column {column}, at {text:?}, and may be truncated: write the file \
         again, or end the line with a line break"
    )]
    Cut {
        /// Name or number of the column.
        column: String,
        /// Text of the cell.
        text: String,
    },
    /// The header contains this column twice.
    #[error("column {0} is given more than once")]
    DuplicateColumn(String),
    /// A cell is not a finite number, or is too large.
    #[error(
        "{column} is {text:?}; it must be a finite number, at most {MAGNITUDE_MAX:e} either way"
    )]
    NotANumber {
        /// Name of the column.
        column: &'static str,
        /// Text of the cell.
        text: String,
    },
    /// Time does not increase.
    #[error(
        "t_s = {time_s} is not after {previous_s} of the previous row: times must increase by at least 1 µs"
    )]
    TimeNotIncreasing {
        /// Time in that row \[s\].
        time_s: f64,
        /// Time in the row before \[s\].
        previous_s: f64,
    },
    /// A quaternion has this length instead of 1.
    #[error("the quaternion has length {0:.4}; it must be 1")]
    NotUnit(f64),
    /// The file has this number of rows, fewer than two.
    #[error("has {}; it needs at least 2 below the header t_s,x_m,y_m,z_m", crate::counted(*.0, "row"))]
    TooShort(usize),
}
