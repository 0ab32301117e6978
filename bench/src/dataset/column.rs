//! A column: the key of its value in a row, and its format.

use std::collections::BTreeMap;

use serde_json::Value;

#[derive(Debug, Clone, Copy)]
pub struct Column {
    pub(super) head: &'static str,
    pub(super) key: &'static str,
    pub(super) show: Show,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Show {
    /// Left-aligned; all other formats are right-aligned.
    Word,
    Plain,
    Short,
    Fixed(usize),
    Signed,
    Power,
    Percent(usize),
}

impl Column {
    pub(super) fn cell(&self, values: &BTreeMap<String, Value>) -> String {
        match values.get(self.key) {
            Some(Value::String(text)) if !text.is_empty() => text.clone(),
            Some(Value::Bool(true)) => "yes".to_owned(),
            Some(Value::Bool(false)) => "no".to_owned(),
            Some(Value::Array(ends)) => {
                let number = |end: &Value| end.as_f64().map(|end| self.number(end));
                let ends = ends.iter().map(|end| match end {
                    Value::String(text) => text.clone(),
                    end => number(end).unwrap_or_default(),
                });
                let between = if matches!(self.show, Show::Word) {
                    ", "
                } else {
                    " to "
                };
                ends.collect::<Vec<_>>().join(between)
            }
            Some(Value::Number(number)) => self.number(number.as_f64().unwrap_or(f64::NAN)),
            _ => "-".to_owned(),
        }
    }

    fn number(&self, value: f64) -> String {
        match self.show {
            Show::Word | Show::Plain => value.to_string(),
            Show::Short => short(value),
            Show::Fixed(digits) => format!("{value:.digits$}"),
            Show::Signed => format!("{value:+.1}"),
            Show::Power => format!("{value:.1e}"),
            Show::Percent(digits) => format!("{:.digits$}", 100.0 * value),
        }
    }
}

/// Declares a constructor for each format, with the head of the column and the key of its values.
macro_rules! columns {
    ($($name:ident($($digits:ident)?) = $show:expr;)+) => {
        $(pub const fn $name(head: &'static str, key: &'static str $(, $digits: usize)?) -> Column {
            Column { head, key, show: $show }
        })+
    };
}

columns! {
    word() = Show::Word;
    plain() = Show::Plain;
    shorted() = Show::Short;
    fixed(digits) = Show::Fixed(digits);
    signed() = Show::Signed;
    power() = Show::Power;
    percent(digits) = Show::Percent(digits);
}

/// Three to four digits without trailing zeros; whole numbers below 10⁶ in full.
fn short(value: f64) -> String {
    let digits = match value.abs() {
        _ if value == value.round() && value.abs() < 1e6 => 0,
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 1.0 => 2,
        size if size >= 1e-3 => 4,
        _ => return format!("{value:.2e}"),
    };
    let text = format!("{value:.digits$}");
    match text.split_once('.') {
        Some(_) => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        None => text,
    }
}
