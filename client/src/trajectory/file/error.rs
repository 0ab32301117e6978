use std::fmt;
use std::path::PathBuf;

use super::MAGNITUDE_MAX;

/// What is wrong with a reference file, and where.
#[derive(Debug)]
pub struct TrajectoryFileError {
    /// The file.
    pub path: PathBuf,
    /// Number of the line, from 1; none: it is about the whole file.
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

/// What may be wrong in a reference file.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryFileProblem {
    /// It cannot be read.
    #[error("{0}")]
    Read(std::io::Error),
    /// It is not CSV.
    #[error("{0}")]
    Csv(String),
    /// The header lacks this column.
    #[error("column {0} is missing; the header is t_s,x_m,y_m,z_m or t_s,x_m,y_m,z_m,qx,qy,qz,qw")]
    MissingColumn(&'static str),
    /// The first line is no header.
    #[error(
        "the header is missing: the first line contains numbers; add the header t_s,x_m,y_m,z_m or \
         t_s,x_m,y_m,z_m,qx,qy,qz,qw"
    )]
    NoHeader,
    /// This stands between the columns, and not a comma.
    #[error("columns are separated by {0:?}: use commas, and decimal points (0.9, not 0,9)")]
    Separator(char),
    /// The last line does not end.
    #[error(
        "the file ends within this line, in column {column}, at {text:?}, and may be truncated: write the file \
         again, or end the line with a line break"
    )]
    Cut {
        /// Name or number of the column.
        column: String,
        /// What stands there.
        text: String,
    },
    /// The header names this column twice.
    #[error("column {0} is given more than once")]
    DuplicateColumn(String),
    /// A cell is not a finite number, or too large.
    #[error(
        "{column} is {text:?}; it must be a finite number, at most {MAGNITUDE_MAX:e} either way"
    )]
    NotANumber {
        /// The column.
        column: &'static str,
        /// What stands there.
        text: String,
    },
    /// Time does not go forward.
    #[error(
        "t_s = {time_s} is not after {previous_s} of the previous row: times must increase by at least 1 µs"
    )]
    TimeNotIncreasing {
        /// Time in that row \[s\].
        time_s: f64,
        /// Time in the row before \[s\].
        previous_s: f64,
    },
    /// A quaternion has this length, and not 1.
    #[error("the quaternion has length {0:.4}; it must be 1")]
    NotUnit(f64),
    /// So many rows are nothing to follow.
    #[error("has {0} rows of data; it needs at least 2 below the header t_s,x_m,y_m,z_m")]
    TooShort(usize),
}
