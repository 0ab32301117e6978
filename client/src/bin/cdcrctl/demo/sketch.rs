use std::io::stdout;

use rustix::termios::tcgetwinsize;

use super::canvas::{Canvas, DOTS, Ink};
use super::shape::Position;

/// Width of what is no terminal.
const COLUMNS: usize = 80;
/// Wider is not clearer.
const COLUMNS_MAX: usize = 120;
/// So wide, a view has room for its title.
const VIEW_COLUMNS_MIN: usize = 38;
const ROWS: usize = 20;
const GAP: &str = "   ";
/// How far apart the dots of the reference are: its line is dotted, that of the backbone is not.
const REFERENCE_STEP: isize = 3;

#[derive(Debug)]
pub(super) struct Sketch {
    pub(super) backbone: Vec<Position>,
    pub(super) reference: Vec<Position>,
    /// When it looked so, since the start of the curve \[s\].
    pub(super) time_s: f64,
}

/// From where: two of the three axes.
#[derive(Debug, Clone, Copy)]
struct View {
    name: &'static str,
    across: usize,
    up: usize,
}

const SIDE: View = View {
    name: "side view: x right, z up",
    across: 0,
    up: 2,
};
const TOP: View = View {
    name: "top view: x right, y up",
    across: 0,
    up: 1,
};

/// Columns of the terminal at the standard output, or of a usual one.
pub(super) fn columns() -> usize {
    let terminal = tcgetwinsize(stdout()).map_or(0, |size| usize::from(size.ws_col));
    match terminal {
        0 => COLUMNS,
        columns => columns.min(COLUMNS_MAX),
    }
}

impl Sketch {
    /// The robot from the side and from above, next to each other where `columns` allow it, with colours.
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
        let frame = Frame::around(self.points().map(|p| view.project(p)), columns);
        let mut canvas = Canvas::new(columns, ROWS);
        self.draw_reference(view, &frame, &mut canvas);
        self.draw_backbone(view, &frame, &mut canvas);
        let title = format!(
            "{}, {} mm a dot",
            view.name,
            two_digits(1e3 * frame.m_per_dot)
        );
        let title: String = title.chars().take(columns).collect();
        let mut lines = vec![format!("{title:<columns$}")];
        lines.extend(canvas.rows());
        lines
    }

    fn points(&self) -> impl Iterator<Item = &Position> {
        self.reference.iter().chain(&self.backbone)
    }

    fn draw_reference(&self, view: View, frame: &Frame, canvas: &mut Canvas) {
        let mut last = None;
        for point in &self.reference {
            let dot = frame.dot(view.project(point));
            if last.is_none_or(|last| steps(last, dot) >= REFERENCE_STEP) {
                canvas.dot(dot, Ink::Reference);
                last = Some(dot);
            }
        }
    }

    /// A line with a blob of four by four dots at its tip.
    fn draw_backbone(&self, view: View, frame: &Frame, canvas: &mut Canvas) {
        let dots = self.backbone.iter().map(|p| frame.dot(view.project(p)));
        let dots: Vec<_> = dots.collect();
        for pair in dots.windows(2) {
            for dot in line(pair[0], pair[1]) {
                canvas.dot(dot, Ink::Backbone);
            }
        }
        if let Some(&(x, y)) = dots.last() {
            for (dx, dy) in (-1..=2).flat_map(|dx| (-1..=2).map(move |dy| (dx, dy))) {
                canvas.dot((x + dx, y + dy), Ink::Tip);
            }
        }
    }

    fn legend(&self) -> String {
        let entry = |ink: Ink, sign: &str, name: &str| {
            let style = ink.style();
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

impl View {
    fn project(self, point: &Position) -> (f64, f64) {
        (point[self.across], point[self.up])
    }
}

/// Which place is which dot, with the same scale in both directions.
#[derive(Debug)]
struct Frame {
    middle_m: (f64, f64),
    middle_dots: (f64, f64),
    m_per_dot: f64,
}

impl Frame {
    /// So that all points and a blob at each of them fit into `columns` and the rows of a picture.
    fn around(points: impl Iterator<Item = (f64, f64)>, columns: usize) -> Self {
        let mut low = (f64::INFINITY, f64::INFINITY);
        let mut high = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for (x, y) in points {
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
        let room = ((columns * DOTS.0) as f64, (ROWS * DOTS.1) as f64);
        // Two dots at each edge for the tip.
        let m_per_dot = ((high.0 - low.0) / (room.0 - 5.0).max(1.0))
            .max((high.1 - low.1) / (room.1 - 5.0).max(1.0));
        Self {
            middle_m: (f64::midpoint(low.0, high.0), f64::midpoint(low.1, high.1)),
            middle_dots: (0.5 * (room.0 - 2.0), 0.5 * (room.1 - 2.0)),
            // A single point has a scale, too.
            m_per_dot: m_per_dot.max(1e-6),
        }
    }

    fn dot(&self, (x, y): (f64, f64)) -> (isize, isize) {
        let place = |m: f64, middle_m: f64, middle: f64| {
            ((m - middle_m) / self.m_per_dot + middle).round() as isize
        };
        (
            place(x, self.middle_m.0, self.middle_dots.0),
            place(y, self.middle_m.1, self.middle_dots.1),
        )
    }
}

/// How many dots lie between two, along the longer axis.
fn steps(a: (isize, isize), b: (isize, isize)) -> isize {
    (a.0 - b.0).abs().max((a.1 - b.1).abs())
}

/// The dots from `a` to `b`.
fn line(a: (isize, isize), b: (isize, isize)) -> impl Iterator<Item = (isize, isize)> {
    let count = steps(a, b).max(1);
    (0..=count).map(move |k| {
        let between = |a: isize, b: isize| {
            (a as f64 + (b - a) as f64 * k as f64 / count as f64).round() as isize
        };
        (between(a.0, b.0), between(a.1, b.1))
    })
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
    use super::super::canvas::tests::plain;
    use super::*;

    /// A straight robot of 1 m, and a reference round its tip.
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
        // The tip is above, with the reference beside it; below it there is the backbone alone.
        assert!(side[0] > 4, "{lines:#?}");
        assert!(
            side[2..].iter().all(|&count| (1..=2).contains(&count)),
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
    fn the_scale_is_the_same_in_both_directions() {
        let points = [(0.0, 0.0), (0.4, 1.0)];
        let frame = Frame::around(points.into_iter(), 38);
        let (a, b) = (frame.dot((0.0, 0.0)), frame.dot((0.1, 0.1)));
        assert!(((b.0 - a.0) - (b.1 - a.1)).abs() <= 1);
        let (low, high) = (frame.dot(points[0]), frame.dot(points[1]));
        assert!(
            low.1 >= 1 && high.1 <= (ROWS * DOTS.1).cast_signed() - 3,
            "{low:?} {high:?}"
        );
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
