use std::path::PathBuf;

use super::MAGNITUDE_MAX;

/// What is wrong with a reference file, and where.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryFileError {
    /// It cannot be read.
    #[error(
        "cannot read {}: {cause}; it must be a CSV file with the columns t_s,x_m,y_m,z_m or \
         t_s,x_m,y_m,z_m,qx,qy,qz,qw",
        path.display()
    )]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It is not CSV.
    #[error("{}:{line}: {cause}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: u64,
        /// Why.
        cause: String,
    },
    /// The header lacks a column.
    #[error(
        "{}:1: column {column} is missing; the header is t_s,x_m,y_m,z_m or \
         t_s,x_m,y_m,z_m,qx,qy,qz,qw",
        path.display()
    )]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: &'static str,
    },
    /// The first line is no header.
    #[error(
        "{}:1: the header is missing: the first line is a row of numbers; put above it t_s,x_m,y_m,z_m or \
         t_s,x_m,y_m,z_m,qx,qy,qz,qw",
        path.display()
    )]
    NoHeader {
        /// The file.
        path: PathBuf,
    },
    /// Something else than a comma stands between the columns.
    #[error(
        "{}:1: {found:?} stands between the columns; put commas there, and points into the numbers (0.9, not 0,9)",
        path.display()
    )]
    Separator {
        /// The file.
        path: PathBuf,
        /// What stands there.
        found: char,
    },
    /// The last line does not end.
    #[error(
        "{}:{line}: the file ends in this line, in column {column}, at {text:?}, which may be half of what was \
         meant: write the file again, or end the line with a line break",
        path.display()
    )]
    Cut {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Name or number of the column.
        column: String,
        /// What stands there.
        text: String,
    },
    /// The header names a column twice.
    #[error("{}:1: column {column} is there more than once", path.display())]
    DuplicateColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// A cell is not a finite number, or too large.
    #[error(
        "{}:{line}: {column} is {text:?}; it must be a finite number, at most {MAGNITUDE_MAX:e} either way",
        path.display()
    )]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What stands there.
        text: String,
    },
    /// Time does not go forward.
    #[error(
        "{}:{line}: t_s = {time_s} does not come after {previous_s} of the row before; \
         times must increase by at least 1 µs",
        path.display()
    )]
    TimeNotIncreasing {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: u64,
        /// Time in that row \[s\].
        time_s: f64,
        /// Time in the row before \[s\].
        previous_s: f64,
    },
    /// A quaternion is not of length 1.
    #[error("{}:{line}: the quaternion has length {norm:.4}; it must be 1", path.display())]
    NotUnit {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: u64,
        /// Its length.
        norm: f64,
    },
    /// There is nothing to follow.
    #[error(
        "{} has {rows} rows of data; a reference needs at least 2 below the header \
         t_s,x_m,y_m,z_m",
        path.display()
    )]
    TooShort {
        /// The file.
        path: PathBuf,
        /// Rows found.
        rows: usize,
    },
}
