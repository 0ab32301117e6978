//! The plots of a run.

use super::leg::Leg;
use super::report::pooled;
use super::round::Round;
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, PURPLE, Panel, SKY, Scale, YELLOW};
use crate::quantiles::quantile_us;

pub(super) fn panels(rounds: &[Round], limit_us: f64) -> Vec<Panel> {
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
        curves: tails(rounds, legs),
    };
    let commands = [
        BareOneWay,
        BareRoundTrip,
        CommandHop,
        CommandHandover,
        CommandRelease,
    ];
    let inputs = [
        ReferenceCommand,
        ReferenceMachinery,
        ObstacleCommand,
        ObstacleMachinery,
        MeasurementCommand,
        MeasurementMachinery,
    ];
    let requests = [
        BareRequest,
        LeaseMachinery,
        LeaseAnswer,
        TrackMachinery,
        TrackAnswer,
    ];
    vec![
        panel("Commands beside iceoryx2 alone", &commands),
        panel(
            "Sent → first command that uses it: whole, and without the wait for the grid",
            &inputs,
        ),
        panel("Request → answer beside iceoryx2 alone", &requests),
        stop_panel(rounds, limit_us * 1e-3),
    ]
}

/// The latency that one sample in x exceeds.
fn tails(rounds: &[Round], legs: &[Leg]) -> Vec<Curve> {
    let colours = [BLUE, SKY, GREEN, YELLOW, ORANGE, PURPLE];
    let curve = |(leg, colour): (&Leg, _)| {
        let latencies = pooled(*leg, rounds)?;
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
fn stop_panel(rounds: &[Round], limit_ms: f64) -> Panel {
    let share = |(leg, colour): (Leg, _)| {
        let latencies = pooled(leg, rounds)?;
        let shares = (0..=200).map(|step| f64::from(step) / 200.0);
        let point = |share: f64| (quantile_us(&latencies, share) * 1e-3, 100.0 * share);
        Some(Curve::line(leg.name(), shares.map(point).collect(), colour))
    };
    let legs = [
        (Leg::StopZeroHandover, BLUE),
        (Leg::StopZeroCommand, ORANGE),
        (Leg::StopGrid, GREEN),
    ];
    let mut curves: Vec<Curve> = legs.into_iter().filter_map(share).collect();
    let bound = vec![(limit_ms, 0.0), (limit_ms, 100.0)];
    curves.push(Curve::line("bound for 99 %", bound, GREY));
    Panel {
        title: "Stop → zero rates, without the ramp".to_owned(),
        x: "ms",
        y: "stops that took no longer, %",
        scale: Scale::Linear,
        curves,
    }
}
