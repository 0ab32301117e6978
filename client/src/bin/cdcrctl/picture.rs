//! View of the robot from one side, drawn with terminal characters. Both directions have the same scale.
//!
//! Invariant: nothing here knows a message.

use std::env;

use anstyle::AnsiColor;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::widgets::Widget;
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line, Points};

use crate::backbone::Position;

/// Spacing of the reference points in dots: the reference is dotted, the path of the tip is a line.
const REFERENCE_STEP: f64 = 3.0;

/// Direction of view: two of the three axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct View {
    pub(crate) name: &'static str,
    /// Short name for narrow screens.
    pub(crate) short: &'static str,
    across: usize,
    up: usize,
}

pub(crate) const SIDE: View = View {
    name: "side view: x right, z up",
    short: "side x, z",
    across: 0,
    up: 2,
};
pub(crate) const FRONT: View = View {
    name: "front view: y right, z up",
    short: "front y, z",
    across: 1,
    up: 2,
};
pub(crate) const TOP: View = View {
    name: "top view: x right, y up",
    short: "top x, y",
    across: 0,
    up: 1,
};

/// A sphere or capsule in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Solid {
    pub(crate) start_m: Position,
    pub(crate) end_m: Position,
    pub(crate) radius_m: f64,
    /// Whether it is within the safe distance of the body.
    pub(crate) is_near: bool,
}

/// Content of the picture; later entries cover earlier ones.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scene {
    pub(crate) obstacles: Vec<Solid>,
    pub(crate) reference: Vec<Position>,
    pub(crate) trail: Vec<Position>,
    /// Base first, tip last.
    pub(crate) backbone: Vec<Position>,
}

/// The visible part of space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Window {
    pub(crate) middle_m: Position,
    /// Extent of the shorter side of the picture \[m\], above 0.
    pub(crate) size_m: f64,
}

/// Characters that a terminal supports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Signs {
    Braille,
    HalfBlocks,
    Ascii,
}

/// Kinds of content, each with its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ink {
    Obstacle,
    NearObstacle,
    Reference,
    Trail,
    Backbone,
    Tip,
}

impl Ink {
    pub(crate) const ALL: [Self; 6] = [
        Self::Obstacle,
        Self::NearObstacle,
        Self::Reference,
        Self::Trail,
        Self::Backbone,
        Self::Tip,
    ];

    /// A colour of the terminal's palette, so that it suits the background.
    pub(crate) fn ansi(self) -> AnsiColor {
        match self {
            Self::Obstacle => AnsiColor::Blue,
            Self::NearObstacle => AnsiColor::Red,
            Self::Reference => AnsiColor::Yellow,
            Self::Trail => AnsiColor::Cyan,
            Self::Backbone => AnsiColor::Green,
            Self::Tip => AnsiColor::Magenta,
        }
    }

    pub(crate) fn color(self) -> Color {
        Color::Indexed(self.ansi() as u8)
    }

    fn letter(self) -> char {
        match self {
            Self::Obstacle => 'o',
            Self::NearObstacle => '@',
            Self::Reference => '.',
            Self::Trail => ',',
            Self::Backbone => '#',
            Self::Tip => 'T',
        }
    }
}

impl Signs {
    /// The best supported characters, according to the environment.
    pub(crate) fn of_terminal() -> Self {
        let of = |key: &str| env::var(key).ok().filter(|value| !value.is_empty());
        let locale = of("LC_ALL")
            .or_else(|| of("LC_CTYPE"))
            .or_else(|| of("LANG"));
        let is_unicode = locale.is_some_and(|locale| {
            let locale = locale.to_uppercase();
            locale.contains("UTF-8") || locale.contains("UTF8")
        });
        match (is_unicode, of("TERM").as_deref()) {
            (false, _) => Self::Ascii,
            // The Linux console has half blocks but no Braille.
            (true, Some("linux")) => Self::HalfBlocks,
            (true, _) => Self::Braille,
        }
    }

    /// Dots per cell, across and up.
    fn dots(self) -> (u16, u16) {
        match self {
            Self::Braille => (2, 4),
            Self::HalfBlocks => (1, 2),
            Self::Ascii => (1, 1),
        }
    }

    /// Marker for lines; `letter` if the terminal has nothing finer.
    pub(crate) fn marker(self, letter: char) -> Marker {
        match self {
            Self::Braille => Marker::Braille,
            Self::HalfBlocks => Marker::HalfBlock,
            Self::Ascii => Marker::Custom(letter),
        }
    }
}

impl View {
    /// The axes that are drawn to the right and upwards.
    pub(crate) fn axes(self) -> [usize; 2] {
        [self.across, self.up]
    }

    fn project(self, point: &Position) -> (f64, f64) {
        (point[self.across], point[self.up])
    }
}

impl Window {
    /// Extent of a picture in `area`, across and up, and of one dot \[m\]. Cells are taken as twice as high
    /// as wide.
    fn extent_m(&self, area: Rect, signs: Signs) -> (f64, f64, f64) {
        let (dots_across, dots_up) = signs.dots();
        let (across, up) = (f64::from(dots_across), f64::from(dots_up));
        // In cell widths, from the middle of the first dot to that of the last.
        let wide = (f64::from(area.width) * across - 1.0).max(1.0) / across;
        let high = (f64::from(area.height) * up - 1.0).max(1.0) / up * 2.0;
        let cell_m = self.size_m / wide.min(high);
        (wide * cell_m, high * cell_m, cell_m / across)
    }
}

impl Scene {
    /// Draws the scene into `area`. Returns the size of a dot \[m\].
    pub(crate) fn draw(
        &self,
        view: View,
        window: &Window,
        signs: Signs,
        area: Rect,
        buffer: &mut Buffer,
    ) -> f64 {
        let (wide_m, high_m, dot_m) = window.extent_m(area, signs);
        let (x, y) = view.project(&window.middle_m);
        Canvas::default()
            .x_bounds([x - 0.5 * wide_m, x + 0.5 * wide_m])
            .y_bounds([y - 0.5 * high_m, y + 0.5 * high_m])
            .paint(|context| self.paint(view, signs, dot_m, context))
            .render(area, buffer);
        dot_m
    }

    fn paint(&self, view: View, signs: Signs, dot_m: f64, context: &mut Context<'_>) {
        let layer =
            |context: &mut Context<'_>, ink: Ink| context.marker(signs.marker(ink.letter()));
        for solid in &self.obstacles {
            let ink = if solid.is_near {
                Ink::NearObstacle
            } else {
                Ink::Obstacle
            };
            layer(context, ink);
            outline(solid, view, ink.color(), context);
        }
        for (points, ink, apart) in [
            (&self.reference, Ink::Reference, REFERENCE_STEP),
            (&self.trail, Ink::Trail, 0.0),
        ] {
            layer(context, ink);
            let coords = thinned(
                points.iter().map(|point| view.project(point)),
                apart * dot_m,
            );
            context.draw(&Points::new(&coords, ink.color()));
        }
        layer(context, Ink::Backbone);
        for pair in self.backbone.windows(2) {
            let (a, b) = (view.project(&pair[0]), view.project(&pair[1]));
            context.draw(&Line::new(a.0, a.1, b.0, b.1, Ink::Backbone.color()));
        }
        if let Some(tip) = self.backbone.last() {
            layer(context, Ink::Tip);
            let (x, y) = view.project(tip);
            let around = i32::from(signs != Signs::Ascii);
            let blob = (-around..=around)
                .flat_map(|i| (-around..=around).map(move |j| (f64::from(i), f64::from(j))))
                .map(|(i, j)| (x + i * dot_m, y + j * dot_m));
            context.draw(&Points::new(&blob.collect::<Vec<_>>(), Ink::Tip.color()));
        }
    }
}

/// Removes points that are closer than `apart_m` to the previous one.
fn thinned(points: impl Iterator<Item = (f64, f64)>, apart_m: f64) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for (x, y) in points {
        let is_near = |last: &(f64, f64)| (x - last.0).hypot(y - last.1) < apart_m;
        if !kept.last().is_some_and(is_near) {
            kept.push((x, y));
        }
    }
    kept
}

/// Circles at both ends, and the lines between them.
fn outline(solid: &Solid, view: View, color: Color, context: &mut Context<'_>) {
    let (a, b) = (view.project(&solid.start_m), view.project(&solid.end_m));
    for (x, y) in [a, b] {
        context.draw(&Circle::new(x, y, solid.radius_m, color));
    }
    let (along, up) = (b.0 - a.0, b.1 - a.1);
    let length_m = along.hypot(up);
    if length_m > 0.0 {
        let (dx, dy) = (
            -up / length_m * solid.radius_m,
            along / length_m * solid.radius_m,
        );
        for side in [1.0, -1.0] {
            let (dx, dy) = (side * dx, side * dy);
            context.draw(&Line::new(a.0 + dx, a.1 + dy, b.0 + dx, b.1 + dy, color));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: Rect = Rect::new(0, 0, 40, 16);

    fn drawn(scene: &Scene, view: View, size_m: f64, signs: Signs) -> Buffer {
        let mut buffer = Buffer::empty(AREA);
        let window = Window {
            middle_m: [0.0, 0.0, 0.5],
            size_m,
        };
        scene.draw(view, &window, signs, AREA, &mut buffer);
        buffer
    }

    /// Columns and rows of the cells with a colour.
    fn inked(buffer: &Buffer, ink: Ink) -> Vec<(u16, u16)> {
        let cells = AREA.positions().filter(|position| {
            let cell = &buffer[*position];
            cell.symbol() != " " && cell.fg == ink.color()
        });
        cells.map(|position| (position.x, position.y)).collect()
    }

    fn extent(places: impl Iterator<Item = u16> + Clone) -> f64 {
        let most = places.clone().max().expect("something is drawn");
        f64::from(most - places.min().expect("something is drawn")) + 1.0
    }

    /// A straight robot of 1 m, and an obstacle of 0.3 m around its middle.
    fn scene() -> Scene {
        Scene {
            backbone: vec![[0.0; 3], [0.0, 0.0, 1.0]],
            obstacles: vec![Solid {
                start_m: [0.0, 0.0, 0.5],
                end_m: [0.0, 0.0, 0.5],
                radius_m: 0.3,
                is_near: true,
            }],
            ..Scene::default()
        }
    }

    #[test]
    fn a_circle_is_round_whatever_the_signs() {
        for signs in [Signs::Braille, Signs::HalfBlocks, Signs::Ascii] {
            for view in [SIDE, FRONT, TOP] {
                let window = Window {
                    middle_m: [0.0, 0.0, 0.5],
                    size_m: 1.2,
                };
                let mut buffer = Buffer::empty(AREA);
                let dot_m = scene().draw(view, &window, signs, AREA, &mut buffer);
                let ring = inked(&buffer, Ink::NearObstacle);
                let wide = extent(ring.iter().map(|place| place.0));
                let high = 2.0 * extent(ring.iter().map(|place| place.1));
                // A row is two columns, and the tip covers one.
                assert!((wide - high).abs() <= 2.0, "{signs:?}: {wide} {high}");
                assert!(dot_m > 0.0 && dot_m < 0.1);
            }
        }
    }

    #[test]
    fn a_straight_robot_is_a_line_from_the_side_and_its_tip_from_above() {
        let mut alone = scene();
        alone.obstacles.clear();
        let side = drawn(&alone, SIDE, 1.2, Signs::Braille);
        let line = inked(&side, Ink::Backbone);
        assert_eq!(extent(line.iter().map(|place| place.0)), 1.0);
        assert!(line.len() > 10, "{line:?}");
        let tip = inked(&side, Ink::Tip);
        assert!(tip.iter().all(|tip| line.iter().all(|at| tip.1 <= at.1)));
        let above = drawn(&alone, TOP, 1.2, Signs::Braille);
        assert!(inked(&above, Ink::Backbone).is_empty());
        assert!((1..=4).contains(&inked(&above, Ink::Tip).len()));
    }

    #[test]
    fn a_rod_has_two_sides_and_what_lies_outside_is_left_out() {
        let mut scene = scene();
        scene.obstacles[0].end_m = [0.0, 0.0, 30.0];
        let buffer = drawn(&scene, SIDE, 1.2, Signs::Ascii);
        let rod = inked(&buffer, Ink::NearObstacle);
        let top: Vec<_> = rod.iter().filter(|place| place.1 == 0).collect();
        assert_eq!(top.len(), 2, "{rod:?}");
    }

    #[test]
    fn bad_numbers_and_no_room_draw_nothing_and_do_no_harm() {
        let mut scene = scene();
        scene.backbone.push([f64::NAN, f64::INFINITY, 0.0]);
        scene.obstacles[0].radius_m = f64::NAN;
        drawn(&scene, SIDE, 1.2, Signs::Braille);
        let nowhere = Rect::new(0, 0, 0, 0);
        let window = Window {
            middle_m: [0.0; 3],
            size_m: 1.0,
        };
        scene.draw(
            SIDE,
            &window,
            Signs::Ascii,
            nowhere,
            &mut Buffer::empty(nowhere),
        );
    }
}
