use core::f64::consts::{FRAC_PI_2, PI, TAU};

use super::Trajectory;

/// Chords of a round for its length: so many that interpolation on a chord is exact enough, and a multiple of
/// most numbers of corners.
const CHORDS: usize = 5040;

/// Shape of a figure, around (0, 0, 0) with radius 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FigureShape {
    /// A helix with 1 to 100 turns and a height of `rise` radii; every other round goes back.
    Helix {
        /// Number of turns.
        turns: u32,
        /// Height, in radii.
        rise: f64,
    },
    /// x = sin(2π a u + π/2), y = sin(2π b u), with a and b from 1 to 100.
    Lissajous([u32; 2]),
    /// r = cos(k φ), with k from 1 to 100: k petals for an odd k, 2 k for an even one.
    Rose(u32),
    /// A regular polygon with 3 to 100 corners, starting at one of them.
    Polygon(u32),
}

/// Plane of a figure, named by the axes of the base frame that are the x and y of the shape. A helix rises
/// along the third axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigurePlane {
    /// Horizontal: across the straight robot.
    Xy,
    /// Vertical, through the x axis.
    Xz,
    /// Vertical, through the y axis.
    Yz,
}

impl FigurePlane {
    /// Maps x and y to the axes of the plane, z to the third axis.
    pub(super) fn placed(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Xy => [x, y, z],
            Self::Xz => [x, z, y],
            Self::Yz => [z, x, y],
        }
    }
}

/// A figure that the tip follows at constant speed, once or repeatedly.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    shape: FigureShape,
    plane: FigurePlane,
    centre_m: [f64; 3],
    radius_m: f64,
    speed_m_s: f64,
    rounds: u32,
    /// Path length from the start of a round to the end of each chord, in radii.
    lengths: Vec<f64>,
}

impl Figure {
    /// Default radius and centre height on the robot's axis, as shares of the robot length; suitable for most
    /// robots of two or more sections.
    pub const SHARES: [f64; 2] = [0.1, 0.85];

    /// A figure with a centre (m, base frame), a radius (m, above 0), a speed (m/s, above 0) and `rounds` (1
    /// or more).
    pub fn new(
        shape: FigureShape,
        plane: FigurePlane,
        (centre_m, radius_m): ([f64; 3], f64),
        speed_m_s: f64,
        rounds: u32,
    ) -> Self {
        let mut length = 0.0;
        let mut lengths = vec![length];
        for chord in 0..CHORDS {
            let [from, to] = [chord, chord + 1].map(|end| shape.point(end as f64 / CHORDS as f64));
            let squares = from.iter().zip(to).map(|(from, to)| (to - from).powi(2));
            length += squares.sum::<f64>().sqrt();
            lengths.push(length);
        }
        Self {
            shape,
            plane,
            centre_m,
            radius_m,
            speed_m_s,
            rounds,
            lengths,
        }
    }

    /// Length of one round \[m\].
    fn length_m(&self) -> f64 {
        self.radius_m * self.lengths[CHORDS]
    }
}

impl FigureShape {
    /// Position after the share `u` of a round.
    fn point(self, u: f64) -> [f64; 3] {
        match self {
            Self::Helix { turns, rise } => {
                let (sin, cos) = (TAU * f64::from(turns) * u).sin_cos();
                [cos, sin, rise * (u - 0.5)]
            }
            Self::Lissajous([a, b]) => {
                let turn = TAU * u;
                let x = (f64::from(a) * turn + FRAC_PI_2).sin();
                [x, (f64::from(b) * turn).sin(), 0.0]
            }
            Self::Rose(k) => {
                // An odd k is complete after half a turn.
                let turn = if k % 2 == 1 { PI * u } else { TAU * u };
                let (sin, cos) = turn.sin_cos();
                let r = (f64::from(k) * turn).cos();
                [r * cos, r * sin, 0.0]
            }
            Self::Polygon(corners) => {
                let side = u * f64::from(corners);
                let corner = side.floor();
                let angle = |corner: f64| TAU * corner / f64::from(corners);
                let [(from_sin, from_cos), (to_sin, to_cos)] =
                    [corner, corner + 1.0].map(|corner| angle(corner).sin_cos());
                let part = side - corner;
                let between = |from: f64, to: f64| from + part * (to - from);
                [between(from_cos, to_cos), between(from_sin, to_sin), 0.0]
            }
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Helix { .. } => "helix",
            Self::Lissajous(_) => "lissajous",
            Self::Rose(_) => "rose",
            Self::Polygon(_) => "polygon",
        }
    }
}

impl Trajectory for Figure {
    fn name(&self) -> &str {
        self.shape.name()
    }

    fn duration_s(&self) -> f64 {
        f64::from(self.rounds) * self.length_m() / self.speed_m_s
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        let gone = time_s.clamp(0.0, self.duration_s()) * self.speed_m_s / self.length_m();
        let before = gone.floor().min(f64::from(self.rounds) - 1.0);
        let mut share = gone - before;
        if matches!(self.shape, FigureShape::Helix { .. }) && before % 2.0 == 1.0 {
            share = 1.0 - share;
        }
        let length = share * self.lengths[CHORDS];
        let after = self.lengths.partition_point(|end| *end <= length);
        let chord = after.saturating_sub(1).min(CHORDS - 1);
        let [from, to] = [self.lengths[chord], self.lengths[chord + 1]];
        let part = ((length - from) / (to - from)).clamp(0.0, 1.0);
        let [x, y, z] = self.shape.point((chord as f64 + part) / CHORDS as f64);
        let placed = self.plane.placed([x, y, z]);
        core::array::from_fn(|i| self.centre_m[i] + self.radius_m * placed[i])
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_near;
    use super::*;

    const CENTRE_M: [f64; 3] = [0.1, -0.2, 0.6];
    const SHAPES: [FigureShape; 6] = [
        FigureShape::Helix {
            turns: 3,
            rise: 1.5,
        },
        FigureShape::Lissajous([3, 2]),
        FigureShape::Rose(5),
        FigureShape::Rose(2),
        FigureShape::Polygon(3),
        FigureShape::Polygon(7),
    ];

    fn figure(shape: FigureShape, plane: FigurePlane) -> Figure {
        Figure::new(shape, plane, (CENTRE_M, 0.05), 0.1, 3)
    }

    fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
        let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
        squares.sum::<f64>().sqrt()
    }

    #[test]
    fn each_goes_evenly_and_without_a_jump_from_round_to_round() {
        for shape in SHAPES {
            let figure = figure(shape, FigurePlane::Xy);
            let steps = 30_000;
            let step_s = figure.duration_s() / f64::from(steps);
            for step in 0..steps {
                let [from, to] = [step, step + 1].map(|k| figure.position_m(f64::from(k) * step_s));
                let speed_m_s = distance_m(from, to) / step_s;
                // A chord cuts a corner, or the reversal of a helix.
                assert!(speed_m_s < 0.1 * 1.001, "{shape:?} {step}: {speed_m_s}");
            }
            let one_s = figure.duration_s() / 3.0;
            let is_helix = matches!(shape, FigureShape::Helix { .. });
            let again_s = if is_helix { 2.0 * one_s } else { one_s };
            assert!(distance_m(figure.position_m(0.0), figure.position_m(again_s)) < 1e-9);
            assert_eq!(
                figure.position_m(-1.0),
                figure.position_m(0.0),
                "its ends stay"
            );
            assert_eq!(
                figure.position_m(1e6),
                figure.position_m(figure.duration_s())
            );
        }
    }

    #[test]
    fn they_are_as_large_and_as_long_as_their_formulas_say() {
        let length_m = |shape| figure(shape, FigurePlane::Xy).length_m();
        let triangle_m = 3.0 * 3.0_f64.sqrt() * 0.05;
        assert!((length_m(FigureShape::Polygon(3)) - triangle_m).abs() < 1e-12);
        let helix_m = 0.05 * (3.0 * TAU).hypot(1.5);
        assert!((length_m(SHAPES[0]) - helix_m).abs() < 1e-6);
        // One round (a = b = 1): a circle.
        assert!((length_m(FigureShape::Lissajous([1, 1])) - 0.05 * TAU).abs() < 1e-6);
        for shape in SHAPES {
            let figure = figure(shape, FigurePlane::Xy);
            let far_m = (0..1000).map(|k| {
                let [x, y, _] = figure.position_m(figure.duration_s() * f64::from(k) / 1000.0);
                let [x, y] = [x - CENTRE_M[0], y - CENTRE_M[1]];
                x.abs().max(y.abs())
            });
            let far_m = far_m.fold(0.0, f64::max);
            assert!(far_m > 0.045 && far_m < 0.05 + 1e-12, "{shape:?}: {far_m}");
        }
    }

    #[test]
    fn a_plane_has_its_axes_in_order() {
        let [x, y, z] = CENTRE_M;
        for (plane, start_m) in [
            (FigurePlane::Xy, [x + 0.05, y, z]),
            (FigurePlane::Xz, [x + 0.05, y, z]),
            (FigurePlane::Yz, [x, y + 0.05, z]),
        ] {
            assert_near(
                figure(FigureShape::Polygon(4), plane).position_m(0.0),
                start_m,
            );
        }
        let rising = figure(SHAPES[0], FigurePlane::Yz);
        let [low, ..] = rising.position_m(0.0);
        let [high, ..] = rising.position_m(rising.duration_s() / 3.0);
        assert!((high - low - 0.05 * 1.5).abs() < 1e-12);
    }
}
