use proptest::prelude::*;

use super::*;

fn padded(values: &[f64]) -> Vector {
    core::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

fn boxed(dimensions: usize, most: f64) -> Region {
    let mut region = Region::EMPTY;
    let most = core::array::from_fn(|i| if i < dimensions { most } else { 0.0 });
    region.reset(
        dimensions,
        [most.map(|most| -most), most],
        f64::INFINITY,
        1.0,
    );
    region
}

#[test]
fn corners_edges_and_regions_without_a_point() {
    let mut region = boxed(2, 1.0);
    let near = |region: &mut Region, x: f64, y: f64| {
        region.nearest(&padded(&[x, y])).map(|p| [p[0], p[1]])
    };
    assert_eq!(near(&mut region, 0.5, -0.5), Some([0.5, -0.5]));
    assert_eq!(near(&mut region, 3.0, 0.5), Some([1.0, 0.5]));
    assert_eq!(near(&mut region, 3.0, -4.0), Some([1.0, -1.0]));
    region.bound(&padded(&[-1.0, -1.0]), 0.0);
    let [x, y] = near(&mut region, 3.0, 3.0).unwrap();
    assert!(x.abs() < 1e-12 && y.abs() < 1e-12, "{x} {y}");
    // A half-space that says the same again, and one that no point satisfies.
    region.bound(&padded(&[-2.0, -2.0]), 0.0);
    assert!(near(&mut region, 3.0, 3.0).is_some());
    region.bound(&padded(&[1.0, 1.0]), 1.0);
    assert_eq!(near(&mut region, 3.0, 3.0), None);
}

#[test]
fn a_full_region_reports_that_it_left_one_out() {
    let mut region = boxed(2, f64::INFINITY);
    for turn in 0..ROWS_MAX {
        let (sin, cos) = (turn as f64).sin_cos();
        region.bound(&padded(&[sin, cos]), -1.0);
        // Nothing that bounds nothing takes a place.
        region.bound(&padded(&[0.0, 0.0]), -1.0);
    }
    assert!(!region.is_full());
    region.bound(&padded(&[1.0, 0.0]), 0.5);
    assert!(region.is_full());
}

proptest! {
    /// The nearest point is inside, and no other point of the region is on the near side of it: for each y inside,
    /// (to - x) · (y - x) ≤ 0.
    #[test]
    fn the_nearest_point_is_inside_and_nothing_inside_is_nearer(
        to in prop::collection::vec(-5.0..5.0_f64, 12),
        normals in prop::collection::vec(prop::collection::vec(-1.0..1.0_f64, 12), 0..40),
        slack in 0.0..0.5_f64,
        inside in prop::collection::vec(-1.0..1.0_f64, 12),
        others in prop::collection::vec(prop::collection::vec(-1.0..1.0_f64, 12), 20),
    ) {
        let mut region = boxed(12, 1.0);
        let inside = padded(&inside);
        for normal in &normals {
            let normal = padded(normal);
            region.bound(&normal, dot(&normal, &inside) - slack);
        }
        let to = padded(&to);
        let nearest = region.nearest(&to);
        prop_assert!(nearest.is_some(), "`inside` is one");
        // The same beside rounding, however many half-spaces there were when it was looked for first.
        let mut grown = Region { row_count: 0, ..region.clone() };
        grown.found.is_known = false;
        for row in &region.rows[..region.row_count] {
            grown.bound(&row.normal, row.bound);
            prop_assert!(grown.nearest(&to).is_some());
        }
        for (one, other) in grown.nearest(&to).unwrap().iter().zip(nearest.unwrap()) {
            prop_assert!((one - other).abs() < 1e-9);
        }
        let nearest = nearest.unwrap();
        let mut violation = |at: &Vector| {
            region.found.at = *at;
            region.mark_all_rows();
            region.most_violated().map_or(0.0, |row| row.bound - dot(&row.normal, at))
        };
        prop_assert!(violation(&nearest) < 1e-12);
        let mut away = to;
        add(&mut away, &nearest, -1.0);
        for other in &others {
            // As far from `inside` towards it as the region goes.
            let mut other = padded(other);
            while violation(&other) > 0.0 {
                let mut half = inside;
                add(&mut half, &inside, -0.5);
                add(&mut half, &other, 0.5);
                other = half;
                if other == inside {
                    break;
                }
            }
            add(&mut other, &nearest, -1.0);
            prop_assert!(dot(&away, &other) < 1e-9);
        }
    }
}
