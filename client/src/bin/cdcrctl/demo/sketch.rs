use std::io::stdout;

use anstyle::Style;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use rustix::termios::tcgetwinsize;

use crate::backbone::Position;
use crate::picture::{Ink, SIDE, Scene, Signs, TOP, View, Window};

/// Width of output that is not a terminal.
const COLUMNS: usize = 80;
/// Maximum width: a wider sketch is not clearer.
const COLUMNS_MAX: usize = 120;
/// Minimum width of a view with its title.
const VIEW_COLUMNS_MIN: usize = 38;
const ROWS: usize = 20;
const GAP: &str = "   ";
/// Margin factor, for the marker at the tip.
const AROUND: f64 = 1.05;

#[derive(Debug)]
pub(super) struct Sketch {
    pub(super) backbone: Vec<Position>,
    pub(super) reference: Vec<Position>,
    /// Time of this shape since the start of the curve \[s\].
    pub(super) time_s: f64,
}

/// Columns of the terminal on standard output, or a default.
pub(super) fn columns() -> usize {
    let terminal = tcgetwinsize(stdout()).map_or(0, |size| usize::from(size.ws_col));
    match terminal {
        0 => COLUMNS,
        columns => columns.min(COLUMNS_MAX),
    }
}

impl Sketch {
    /// Views of the robot from the side and from above with colours, side by side if `columns` allow it.
    pub(super) fn text(&self, columns: usize) -> String {
        let beside = columns.saturating_sub(GAP.len()) / 2;
        let mut lines: Vec<String> = if beside >= VIEW_COLUMNS_MIN {
            let [side, top] = [SIDE, TOP].map(|view| self.view(view, beside));
            let rows = side.into_iter().zip(top);
            rows.map(|(left, right)| format!("{left}{GAP}{right}"))
                .collect()
        } else {
            let columns = columns.clamp(1, COLUMNS_MAX);
            [self.view(SIDE, columns), self.view(TOP, columns)].concat()
        };
        lines.push(self.legend());
        lines
            .iter()
            .fold(String::new(), |text, line| text + line.trim_end() + "\n")
    }

    /// A title and the picture below it, every line `columns` wide.
    fn view(&self, view: View, columns: usize) -> Vec<String> {
        let area = Rect::new(0, 0, columns as u16, ROWS as u16);
        let mut picture = Buffer::empty(area);
        let scene = Scene {
            backbone: self.backbone.clone(),
            reference: self.reference.clone(),
            ..Scene::default()
        };
        let window = self.window(view, columns as f64);
        let dot_m = scene.draw(view, &window, Signs::Braille, area, &mut picture);
        let title = format!("{}, {} mm a dot", view.name, two_digits(1e3 * dot_m));
        let title: String = title.chars().take(columns).collect();
        let mut lines = vec![format!("{title:<columns$}")];
        lines.extend(area.rows().map(|row| styled(&picture, row)));
        lines
    }

    /// Window that fits everything into a view of `columns`.
    fn window(&self, view: View, columns: f64) -> Window {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for point in self.reference.iter().chain(&self.backbone) {
            low = core::array::from_fn(|i| low[i].min(point[i]));
            high = core::array::from_fn(|i| high[i].max(point[i]));
        }
        let [across_m, up_m] = view.axes().map(|axis| high[axis] - low[axis]);
        // A row is as high as two columns are wide.
        let rows = 2.0 * ROWS as f64;
        let column_m = (across_m / columns).max(up_m / rows);
        Window {
            middle_m: core::array::from_fn(|i| f64::midpoint(low[i], high[i])),
            // The minimum gives a single point a scale, too.
            size_m: (AROUND * column_m * columns.min(rows)).max(1e-3),
        }
    }

    fn legend(&self) -> String {
        let entry = |ink: Ink, sign: &str, name: &str| {
            let style = style(ink);
            format!("{style}{sign}{style:#} {name}")
        };
        format!(
            "{}   {}   {}   after {:.2} s",
            entry(Ink::Backbone, "⠤⠤", "backbone"),
            entry(Ink::Tip, "⣿⣿", "tip"),
            entry(Ink::Reference, "⠂⠐", "reference"),
            self.time_s
        )
    }
}

/// The cells of a row, with a style for each run of one ink.
fn styled(picture: &Buffer, row: Rect) -> String {
    let cells: Vec<_> = row.positions().map(|place| &picture[place]).collect();
    let stretches = cells.chunk_by(|a, b| a.fg == b.fg);
    let text = stretches.map(|cells| {
        let signs: String = cells.iter().map(|cell| cell.symbol()).collect();
        match Ink::ALL.into_iter().find(|ink| ink.color() == cells[0].fg) {
            Some(ink) => format!("{style}{signs}{style:#}", style = style(ink)),
            None => signs,
        }
    });
    text.collect()
}

fn style(ink: Ink) -> Style {
    Style::new().fg_color(Some(ink.ansi().into()))
}

fn two_digits(mm: f64) -> String {
    if mm < 9.95 {
        format!("{mm:.1}")
    } else {
        format!("{mm:.0}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without colours, and with blanks for empty Braille cells.
    fn plain(text: &str) -> String {
        anstream::adapter::strip_str(text).to_string()
    }

    /// A straight robot of 1 m, and a circular reference around its tip.
    fn sketch() -> Sketch {
        let angles = (0..200).map(|k| f64::from(k) * 0.0314);
        Sketch {
            backbone: (0..=10).map(|k| [0.0, 0.0, 0.1 * f64::from(k)]).collect(),
            reference: angles
                .map(|a| [0.3 * a.cos(), 0.3 * a.sin(), 1.0])
                .collect(),
            time_s: 4.97,
        }
    }

    fn lines(columns: usize) -> Vec<String> {
        let text = plain(&sketch().text(columns));
        text.lines().map(str::to_owned).collect()
    }

    #[test]
    fn both_views_stand_next_to_each_other_where_there_is_room() {
        let wide = lines(80);
        assert_eq!(wide.len(), 1 + ROWS + 1);
        assert!(wide[0].contains("side view") && wide[0].contains("top view"));
        assert!(wide.iter().all(|line| line.chars().count() <= 80));
        let narrow = lines(60);
        assert_eq!(narrow.len(), 2 * (1 + ROWS) + 1);
        assert!(narrow[0].contains("side view") && narrow[ROWS + 1].contains("top view"));
        assert!(narrow.iter().all(|line| line.chars().count() <= 60));
        assert!(wide[ROWS + 1].contains("after 4.97 s"));
    }

    #[test]
    fn a_straight_robot_is_a_line_upwards_from_the_side_and_a_point_from_above() {
        let lines = lines(80);
        let half =
            |line: &String, from: usize| line.chars().skip(from).take(38).collect::<String>();
        let is_inked = |text: &str| text.chars().filter(|c| !c.is_whitespace()).count();
        let (mut side, mut top) = (Vec::new(), Vec::new());
        for line in &lines[1..=ROWS] {
            side.push(is_inked(&half(line, 0)));
            top.push(is_inked(&half(line, 41)));
        }
        // The tip is at the top, with the reference beside it; below it there is only the backbone.
        assert!(side[..2].iter().any(|&count| count > 4), "{lines:#?}");
        assert!(
            side[2..ROWS - 1]
                .iter()
                .all(|&count| (1..=2).contains(&count)),
            "{lines:#?}"
        );
        // The reference is a circle: between its top and its bottom it has two sides.
        assert!(
            top[1..ROWS - 1].iter().all(|&count| count >= 2),
            "{lines:#?}"
        );
        let middle = half(&lines[ROWS / 2], 41);
        let left = middle.chars().take(10).filter(|c| *c != ' ').count();
        assert!(left > 0 && left < 10, "{middle}");
    }

    #[test]
    fn a_robot_that_is_a_point_can_be_drawn() {
        let sketch = Sketch {
            backbone: vec![[0.0; 3]],
            reference: Vec::new(),
            time_s: 0.0,
        };
        let text = plain(&sketch.text(80));
        let picture = text.lines().skip(1).take(ROWS);
        let inked = picture.flat_map(str::chars).filter(|c| *c != ' ').count();
        assert!((8..=18).contains(&inked), "one blob in each view: {text}");
    }
}
