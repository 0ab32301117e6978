//! The pictures of a run.

use super::leg::Leg;
use super::report::Report;
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, PURPLE, Panel, SKY, Scale, YELLOW};
use crate::closed_loop::quantile_us;

impl Report {
    pub(super) fn panels(&self) -> Vec<Panel> {
        use Leg::{
            BareOneWay, BareRequest, BareRoundTrip, CommandHandover, CommandHop, CommandRelease,
            LeaseAnswer, LeaseMachinery, MeasurementCommand, MeasurementMachinery, ObstacleCommand,
            ObstacleMachinery, ReferenceCommand, ReferenceMachinery, TrackAnswer, TrackMachinery,
        };
        let panel = |title: &str, legs: &[Leg]| Panel {
            title: title.to_owned(),
            x: "one sample in so many takes longer",
            y: "µs",
            scale: Scale::LogLog { floor: 0.01 },
            curves: self.tails(legs),
        };
        vec![
            panel(
                "Commands beside iceoryx2 alone",
                &[
                    BareOneWay,
                    BareRoundTrip,
                    CommandHop,
                    CommandHandover,
                    CommandRelease,
                ],
            ),
            panel(
                "Sent → first command that uses it: whole, and without the wait for the grid",
                &[
                    ReferenceCommand,
                    ReferenceMachinery,
                    ObstacleCommand,
                    ObstacleMachinery,
                    MeasurementCommand,
                    MeasurementMachinery,
                ],
            ),
            panel(
                "Request → answer beside iceoryx2 alone",
                &[
                    BareRequest,
                    LeaseMachinery,
                    LeaseAnswer,
                    TrackMachinery,
                    TrackAnswer,
                ],
            ),
            self.stop_panel(),
        ]
    }

    /// The latency that one sample in x exceeds.
    fn tails(&self, legs: &[Leg]) -> Vec<Curve> {
        let colours = [BLUE, SKY, GREEN, YELLOW, ORANGE, PURPLE];
        let curve = |(leg, colour): (&Leg, _)| {
            let latencies = self.pooled(*leg)?;
            // Up to 1.1²⁰⁰, far more than anybody samples.
            let points = (0..200)
                .map(|step| 1.1_f64.powi(step))
                .take_while(|one_in| *one_in <= latencies.len() as f64)
                .map(|one_in| (one_in, quantile_us(&latencies, 1.0 - 1.0 / one_in)))
                .collect();
            Some(Curve::line(leg.name(), points, colour))
        };
        legs.iter().zip(colours).filter_map(curve).collect()
    }

    /// The share of stops that took at most so long.
    fn stop_panel(&self) -> Panel {
        let share = |(leg, colour): (Leg, _)| {
            let latencies = self.pooled(leg)?;
            let quantiles = (0..=200).map(|step| f64::from(step) / 200.0);
            let point = |share: f64| (quantile_us(&latencies, share) * 1e-3, 100.0 * share);
            Some(Curve::line(
                leg.name(),
                quantiles.map(point).collect(),
                colour,
            ))
        };
        let limit_ms = self.stop_limit_us() * 1e-3;
        let legs = [
            (Leg::StopZeroHandover, BLUE),
            (Leg::StopZeroCommand, ORANGE),
            (Leg::StopGrid, GREEN),
        ];
        let mut curves: Vec<Curve> = legs.into_iter().filter_map(share).collect();
        curves.push(Curve::line(
            "bound for 99 %",
            vec![(limit_ms, 0.0), (limit_ms, 100.0)],
            GREY,
        ));
        Panel {
            title: "Stop → zero rates, without the ramp".to_owned(),
            x: "ms",
            y: "stops that took no longer, %",
            scale: Scale::Linear,
            curves,
        }
    }
}
