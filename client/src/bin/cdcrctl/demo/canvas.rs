use anstyle::{AnsiColor, Style};

/// Dots of one character across and up: Unicode's Braille patterns.
pub(super) const DOTS: (usize, usize) = (2, 4);

/// Bits of the pattern, row by row from the top, left and right.
const BITS: [[u8; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];
/// The pattern without dots.
const BLANK: u32 = 0x2800;

/// What a dot belongs to. In a character with several the last one gives the colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Ink {
    Reference,
    Backbone,
    Tip,
}

impl Ink {
    /// Of the terminal's own colours, so that they suit its background.
    pub(super) fn style(self) -> Style {
        let colour = match self {
            Self::Reference => AnsiColor::Cyan,
            Self::Backbone => AnsiColor::Yellow,
            Self::Tip => AnsiColor::Red,
        };
        let style = Style::new().fg_color(Some(colour.into()));
        if self == Self::Tip {
            style.bold()
        } else {
            style
        }
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    bits: u8,
    ink: Option<Ink>,
}

/// A picture of dots for a terminal.
#[derive(Debug)]
pub(super) struct Canvas {
    columns: usize,
    cells: Vec<Cell>,
}

impl Canvas {
    /// An empty picture of so many characters.
    pub(super) fn new(columns: usize, rows: usize) -> Self {
        Self {
            columns,
            cells: vec![Cell::default(); columns * rows],
        }
    }

    /// Sets the dot at `(x, y)`, counted from the lower left; outside of the picture it has no effect.
    pub(super) fn dot(&mut self, (x, y): (isize, isize), ink: Ink) {
        let height = self.cells.len() / self.columns.max(1) * DOTS.1;
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else {
            return;
        };
        if x >= self.columns * DOTS.0 || y >= height {
            return;
        }
        let down = height - 1 - y;
        let cell = &mut self.cells[down / DOTS.1 * self.columns + x / DOTS.0];
        cell.bits |= BITS[down % DOTS.1][x % DOTS.0];
        cell.ink = cell.ink.max(Some(ink));
    }

    /// The rows from the top, each as wide as the picture, with colours.
    pub(super) fn rows(&self) -> impl Iterator<Item = String> {
        self.cells.chunks(self.columns).map(|row| {
            let pieces = row.chunk_by(|a, b| a.ink == b.ink);
            pieces.map(piece).collect()
        })
    }
}

/// Neighbours of one colour.
fn piece(cells: &[Cell]) -> String {
    let characters: String = cells.iter().map(character).collect();
    match cells.first().and_then(|cell| cell.ink) {
        None => characters,
        Some(ink) => {
            let style = ink.style();
            format!("{style}{characters}{style:#}")
        }
    }
}

fn character(cell: &Cell) -> char {
    match cell.bits {
        0 => ' ',
        bits => char::from_u32(BLANK + u32::from(bits)).unwrap_or(' '),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Without the colours.
    pub(in crate::demo) fn plain(text: &str) -> String {
        anstream::adapter::strip_str(text).to_string()
    }

    #[test]
    fn each_dot_has_its_place_in_its_character() {
        let mut canvas = Canvas::new(3, 2);
        for (dot, ink) in [
            ((0, 0), Ink::Reference),
            ((1, 7), Ink::Reference),
            ((2, 4), Ink::Backbone),
            ((3, 5), Ink::Backbone),
        ] {
            canvas.dot(dot, ink);
        }
        let rows: Vec<String> = canvas.rows().map(|row| plain(&row)).collect();
        assert_eq!(rows, ["⠈⡠ ", "⡀  "]);
    }

    #[test]
    fn what_lies_outside_is_left_out() {
        let mut canvas = Canvas::new(2, 1);
        for dot in [(-1, 0), (0, -1), (4, 0), (0, 4), (isize::MAX, isize::MAX)] {
            canvas.dot(dot, Ink::Tip);
        }
        assert_eq!(canvas.rows().collect::<Vec<_>>(), ["  "]);
    }

    #[test]
    fn the_tip_covers_the_backbone_and_that_the_reference() {
        let mut canvas = Canvas::new(2, 1);
        canvas.dot((0, 0), Ink::Tip);
        canvas.dot((1, 0), Ink::Backbone);
        canvas.dot((2, 0), Ink::Backbone);
        canvas.dot((3, 0), Ink::Reference);
        let (tip, backbone) = (Ink::Tip.style(), Ink::Backbone.style());
        assert_eq!(
            canvas.rows().collect::<Vec<_>>(),
            [format!("{tip}⣀{tip:#}{backbone}⣀{backbone:#}")]
        );
    }
}
