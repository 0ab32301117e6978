//! A section's three cables together: what no bend explains.

use cdcr_controller::plant::Preset;
use cdcr_controller::safety::{Mode, Reason, Request};

use super::trial::Trial;
use crate::config::Interface;

const COMMON: Mode = Mode::Faulted {
    reason: Reason::CommonMode,
};

/// How far these cables have drifted from what the encoders said when control began, at 0.1 mm a cycle, when the robot faulted \[mm\]; after 10 mm: none.
fn drift_mm(trial: &mut Trial, cables: &[usize]) -> Option<f64> {
    (1..=100)
        .map(f64::from)
        .map(|tenths| 0.1 * tenths)
        .find(|mm| {
            for cable in cables {
                trial.cable_error_m[*cable] = 1e-3 * mm;
            }
            trial.turn().mode == COMMON
        })
}

/// One cable by 10 mm, or all three of a section by 3: a fault with a reason of its own. All three move no bend, so nothing else sees them.
#[test]
fn cables_that_no_bend_explains_are_a_fault() {
    let lenient = "[safety]\nfollowing_fault_rad = 3.0\n";
    for interface in [Interface::Position, Interface::Velocity] {
        for (cables, from_mm, more) in [
            (&[4][..], 9.0, lenient),
            (&[3, 4, 5], 3.0, ""),
            (&[0, 1, 2], 3.0, ""),
        ] {
            let mut trial = Trial::with(interface, Preset::Laboratory.flaws(), more);
            trial.turns(5);
            trial.begin_tracking();
            assert!(matches!(trial.turns(200).mode, Mode::Tracking { .. }));
            let mm = drift_mm(&mut trial, cables).unwrap();
            assert!(
                (from_mm - 0.2..=from_mm + 0.4).contains(&mm),
                "{cables:?}: {mm} mm"
            );
            if cables.len() < 3 {
                continue; // Its bends are wrong, too.
            }
            // After a reset it counts from there.
            trial.turns(20);
            let after = trial.ask(Request::Reset);
            assert!(matches!(after.mode, Mode::Holding { .. }));
            assert!(matches!(trial.turns(50).mode, Mode::Holding { .. }));
        }
        let mut off = Trial::with(
            interface,
            Preset::Laboratory.flaws(),
            "[safety]\ncable_common_m = 0.0\n",
        );
        off.turns(5);
        assert_eq!(drift_mm(&mut off, &[3, 4, 5]), None);
    }
}
