//! Every transition of the mode, observed or asked for, and every refusal.

use super::*;

const TRACK: Request = Request::Track { lease_number: 0 };
const HOLDING: Mode = Mode::Holding {
    reason: Reason::Start,
};

fn good() -> Observation {
    Observation {
        measured: true,
        reference: ReferenceState::Inside,
        lease: LeaseState::Held,
        ..Observation::default()
    }
}

fn machine(mode: Mode) -> ModeMachine {
    ModeMachine {
        mode,
        ..ModeMachine::default()
    }
}

fn after(mode: Mode, seen: Observation) -> Mode {
    let mut machine = machine(mode);
    machine.observe(&seen);
    machine.mode()
}

fn asked(mode: Mode, request: Request, seen: Observation) -> Result<Mode, Refusal> {
    let mut machine = machine(mode);
    machine.request(request, &seen)?;
    Ok(machine.mode())
}

#[test]
fn every_observed_transition() {
    let tracking = Mode::Tracking { begun: true };
    let held = |reason| Mode::Holding { reason };
    assert_eq!(after(Mode::Starting, good()), held(Reason::Start));
    let unknown = Observation {
        measured: false,
        fault: Some(Reason::MeasurementLost),
        ..good()
    };
    assert_eq!(after(Mode::Starting, unknown), Mode::Starting);
    assert_eq!(after(tracking, good()), tracking);
    let ended = Observation {
        reference: ReferenceState::Ended,
        ..good()
    };
    assert_eq!(after(tracking, ended), held(Reason::ReferenceEnded));
    let silent = Observation {
        lease: LeaseState::Expired,
        ..good()
    };
    assert_eq!(after(tracking, silent), held(Reason::LeaseExpired));
    let acquired_anew = Observation {
        lease_number: 1,
        ..good()
    };
    assert_eq!(after(tracking, acquired_anew), held(Reason::LeaseExpired));
    let released = Observation {
        lease: LeaseState::Free,
        ..good()
    };
    assert_eq!(after(tracking, released), held(Reason::LeaseReleased));
    let home = Observation {
        at_home: true,
        ..good()
    };
    assert_eq!(after(Mode::Homing, home), held(Reason::HomeReached));
    assert_eq!(after(Mode::Homing, good()), Mode::Homing);
    let late = Observation {
        misses_overflow: true,
        ..good()
    };
    assert_eq!(
        after(tracking, late),
        Mode::Stopped {
            reason: Reason::DeadlineMisses
        }
    );
    let lost = Observation {
        fault: Some(Reason::MeasurementLost),
        ..good()
    };
    for mode in [
        Mode::Starting,
        HOLDING,
        tracking,
        Mode::Homing,
        Mode::Stopped {
            reason: Reason::Request,
        },
    ] {
        assert_eq!(
            after(mode, lost),
            Mode::Faulted {
                reason: Reason::MeasurementLost
            }
        );
    }
}

#[test]
fn latched_modes_stay_until_reset_and_reset_waits_for_the_cause() {
    let stopped = Mode::Stopped {
        reason: Reason::Request,
    };
    let faulted = Mode::Faulted {
        reason: Reason::NonFinite,
    };
    for mode in [stopped, faulted] {
        assert_eq!(after(mode, good()), mode);
        for request in [TRACK, Request::Hold, Request::Home] {
            assert_eq!(asked(mode, request, good()), Err(Refusal::WrongMode));
        }
        let unmeasured = Observation {
            measured: false,
            ..good()
        };
        let standing = Observation {
            fault: Some(Reason::NonFinite),
            ..good()
        };
        let overflows = Observation {
            misses_overflow: true,
            ..good()
        };
        for (seen, cause) in [
            (unmeasured, Reason::MeasurementLost),
            (standing, Reason::NonFinite),
            (overflows, Reason::DeadlineMisses),
        ] {
            let refused = asked(mode, Request::Reset, seen);
            assert_eq!(refused, Err(Refusal::CauseStands));
            assert_eq!(seen.reset_refused_by(), Some(cause));
        }
        assert_eq!(good().reset_refused_by(), None);
        let elsewhere = |fault| Observation {
            fault,
            pose_differs: true,
            ..good()
        };
        let refused = asked(mode, Request::Reset, elsewhere(None));
        assert_eq!(refused, Err(Refusal::PoseDiffers));
        let reason = elsewhere(None).reset_refused_by();
        assert_eq!(reason, Some(Reason::PoseDiffers));
        let accepting = Request::ResetAcceptingPose;
        let holding = Mode::Holding {
            reason: Reason::Request,
        };
        for seen in [elsewhere(None), good()] {
            assert_eq!(asked(mode, accepting, seen), Ok(holding));
        }
        // The pose alone is accepted, no fault.
        let refused = asked(mode, accepting, elsewhere(Some(Reason::LimitBroken)));
        assert_eq!(refused, Err(Refusal::CauseStands));
        // It is the pose of the same bends that the tip contradicts.
        let contradicted = Observation {
            tip_contradiction_m: 0.12,
            ..elsewhere(None)
        };
        for request in [Request::Reset, accepting] {
            let refused = asked(mode, request, contradicted);
            assert_eq!(refused, Err(Refusal::TipElsewhere));
        }
        let reason = contradicted.reset_refused_by();
        assert_eq!(reason, Some(Reason::TipElsewhere));
        // Nobody knows what a rejected measurement would have shown.
        let blind = Observation {
            measurement_rejected: true,
            ..good()
        };
        for request in [Request::Reset, accepting] {
            assert_eq!(asked(mode, request, blind), Err(Refusal::CauseStands));
        }
        assert_eq!(blind.reset_refused_by(), Some(Reason::MeasurementJump));
        let reset = asked(mode, Request::Reset, good());
        assert_eq!(
            reset,
            Ok(Mode::Holding {
                reason: Reason::Request
            })
        );
    }
    assert_eq!(asked(faulted, Request::Stop, good()), Ok(faulted));
}

#[test]
fn tracking_goes_on_with_the_lease_that_it_began_with_alone() {
    let of_lease = |lease_number| Observation {
        lease_number,
        ..good()
    };
    let mut machine = machine(HOLDING);
    let track = |lease_number| Request::Track { lease_number };
    machine.request(track(7), &of_lease(7)).unwrap();
    machine.observe(&of_lease(7));
    assert_eq!(machine.mode(), Mode::Tracking { begun: true });
    machine.observe(&of_lease(8));
    let reason = Reason::LeaseExpired;
    assert_eq!(machine.mode(), Mode::Holding { reason });
    // Asked while the lease was the one before, and carried out late.
    let late = machine.request(track(7), &of_lease(8));
    assert_eq!(late, Err(Refusal::NoLease));
    assert_eq!(machine.mode(), Mode::Holding { reason });
    machine.request(track(8), &of_lease(8)).unwrap();
    machine.observe(&of_lease(8));
    assert_eq!(machine.mode(), Mode::Tracking { begun: true });
}

#[test]
fn tracking_needs_a_lease_and_a_reference_ahead() {
    let begun = Ok(Mode::Tracking { begun: false });
    assert_eq!(asked(HOLDING, TRACK, good()), begun);
    let before = Observation {
        reference: ReferenceState::Before,
        ..good()
    };
    assert_eq!(asked(HOLDING, TRACK, before), begun);
    for state in [ReferenceState::None, ReferenceState::Ended] {
        let seen = Observation {
            reference: state,
            ..good()
        };
        assert_eq!(asked(HOLDING, TRACK, seen), Err(Refusal::NoReference));
    }
    let seen = Observation {
        lease: LeaseState::Expired,
        ..good()
    };
    assert_eq!(asked(HOLDING, TRACK, seen), Err(Refusal::NoLease));
    assert_eq!(asked(Mode::Homing, TRACK, good()), Err(Refusal::WrongMode));
}

#[test]
fn a_stop_wins_over_every_other_request_of_its_cycle() {
    let others = [TRACK, Request::Hold, Request::Home, Request::Reset];
    let stopped = Mode::Stopped {
        reason: Reason::Request,
    };
    for mode in [
        HOLDING,
        Mode::Tracking { begun: true },
        Mode::Homing,
        stopped,
    ] {
        for other in others {
            for order in [[other, Request::Stop], [Request::Stop, other]] {
                let mut machine = machine(mode);
                let asked = order.map(Some);
                let answers = machine.requests(&asked, false, &good());
                assert_eq!(machine.mode(), stopped);
                for (asked, answer) in order.iter().zip(answers) {
                    let expected = match asked {
                        Request::Stop => Ok(()),
                        _ => Err(Refusal::Overruled),
                    };
                    assert_eq!(answer, Some(expected));
                }
            }
            let mut machine = machine(mode);
            let answers = machine.requests(&[Some(other), None], true, &good());
            assert_eq!(machine.mode(), stopped);
            assert_eq!(answers, [Some(Err(Refusal::Overruled)), None]);
        }
    }
}

#[test]
fn nothing_moves_a_robot_whose_daemon_ends() {
    let faulted = Mode::Faulted {
        reason: Reason::NonFinite,
    };
    for mode in [
        Mode::Starting,
        HOLDING,
        Mode::Tracking { begun: true },
        Mode::Homing,
        faulted,
    ] {
        let mut machine = machine(mode);
        machine.shut_down();
        let rests = machine.mode();
        assert!(rests.is_latched());
        for request in [Request::Reset, TRACK, Request::Home, Request::Hold] {
            assert_eq!(machine.request(request, &good()), Err(Refusal::Ending));
        }
        machine.observe(&good());
        assert_eq!(machine.mode(), rests);
        // A stop counts beyond the end, which it is not a reason for.
        let stopped = Mode::Stopped {
            reason: Reason::Request,
        };
        let stopped = if mode == faulted { faulted } else { stopped };
        let all = [
            Request::Reset,
            TRACK,
            Request::Home,
            Request::Hold,
            Request::Stop,
        ];
        let answers = machine.requests(&all.map(Some), false, &good());
        machine.shut_down();
        machine.observe(&good());
        assert_eq!(machine.mode(), stopped);
        assert_eq!(answers[0], Some(Err(Refusal::Ending)));
    }
}

#[test]
fn what_was_stopped_before_the_start_waits_for_a_reset() {
    let reason = Reason::StoppedBefore;
    let mut machine = ModeMachine::stopped_before(reason);
    machine.observe(&Observation::default());
    assert_eq!(machine.mode(), Mode::Starting, "nothing is measured");
    assert_eq!(
        machine.request(Request::Reset, &Observation::default()),
        Err(Refusal::WrongMode)
    );
    machine.observe(&good());
    assert_eq!(machine.mode(), Mode::Stopped { reason });
    for request in [TRACK, Request::Home, Request::Hold] {
        assert_eq!(machine.request(request, &good()), Err(Refusal::WrongMode));
    }
    assert_eq!(machine.request(Request::Reset, &good()), Ok(()));
    machine.observe(&good());
    assert!(!machine.mode().is_latched());
}

#[test]
fn what_has_stopped_keeps_its_first_reason() {
    let late = Mode::Stopped {
        reason: Reason::DeadlineMisses,
    };
    assert_eq!(asked(late, Request::Stop, good()), Ok(late));
}

#[test]
fn requests_of_one_cycle_are_carried_out_in_their_order() {
    let mut machine = machine(Mode::Stopped {
        reason: Reason::Request,
    });
    let asked = [TRACK, Request::Reset, Request::Home, Request::Hold].map(Some);
    let answers = machine.requests(&asked, false, &good());
    let expected = [Err(Refusal::WrongMode), Ok(()), Ok(()), Ok(())].map(Some);
    assert_eq!(answers, expected);
    assert_eq!(machine.mode().reason(), Reason::Request);
}

#[test]
fn stop_wins_everywhere_and_faults_are_counted_once() {
    for mode in [
        Mode::Starting,
        HOLDING,
        Mode::Tracking { begun: true },
        Mode::Homing,
    ] {
        let stopped = asked(mode, Request::Stop, good());
        assert_eq!(
            stopped,
            Ok(Mode::Stopped {
                reason: Reason::Request
            })
        );
    }
    let mut machine = machine(HOLDING);
    machine.fault(Reason::NonFinite);
    machine.fault(Reason::LimitBroken);
    assert_eq!(
        (machine.faults(), machine.mode().reason()),
        (1, Reason::NonFinite)
    );
}
