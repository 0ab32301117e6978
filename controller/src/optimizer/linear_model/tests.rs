use super::*;

/// Slacks of the stored constraints, after adding constraints of these kinds and slacks.
fn seen(room: usize, constraints: &[(usize, f64)]) -> Vec<f64> {
    let mut model = LinearModel::with_capacity(0, room, 1, 1);
    model.clear(&Stages::one(1), false);
    for &(kind, slack) in constraints {
        model.push_constraint(kind, slack, slack, &[-1.0], RowStage::FIRST_BLOCK);
    }
    let met = model.activate_violated(&[100.0], &mut Budget::unlimited());
    assert_eq!(met, Some(()));
    let mut seen: Vec<f64> = (0..model.rows()).map(|row| model.residual(row)).collect();
    seen.sort_by(f64::total_cmp);
    seen
}

#[test]
fn of_too_many_constraints_a_step_sees_those_with_the_least_slack() {
    let one_kind = [5.0, -1.0, 4.0, 9.0, -2.0, 3.0].map(|slack| (0, slack));
    assert_eq!(seen(3, &one_kind), [-2.0, -1.0, 3.0]);
}

#[test]
fn no_kind_of_constraint_displaces_another_from_its_part() {
    let near = [5.0, -1.0, 4.0, 9.0, -2.0, 3.0].map(|slack| (0, slack));
    let far = [70.0, 90.0, 60.0].map(|slack| (1, slack));
    for mixed in [[&near[..], &far].concat(), [&far[..], &near].concat()] {
        assert_eq!(seen(4, &mixed), [-2.0, -1.0, 60.0, 70.0]);
        // A kind may use the places that the other leaves.
        assert_eq!(
            seen(8, &mixed),
            [-2.0, -1.0, 3.0, 4.0, 5.0, 60.0, 70.0, 90.0]
        );
    }
}
