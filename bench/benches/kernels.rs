//! Times of the kernels; `cdcr-bench solver` measures whole solves. One second each: fast rather than precise.

use std::hint::black_box;
use std::time::Duration;

use cdcr_controller::robot::{
    Configuration, Jacobian, Obstacle, Robot, RobotParameters, SECTIONS_MAX, Shape,
};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;

/// A robot with a slightly different bend in each section.
fn bent(sections: usize) -> (Robot, Configuration) {
    let angles: Vec<[f64; 2]> = (0..sections).map(|j| [0.7, 1.1 * j as f64]).collect();
    let robot = Robot::new(&RobotParameters::paper(sections)).expect("the paper's robot");
    (robot, Configuration::from_bend_angles(&angles))
}

fn obstacle(shape: Shape) -> Obstacle {
    Obstacle::new(shape, 0.01, Vector3::zeros()).expect("an obstacle")
}

fn kinematics(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tip");
    for sections in [1, 3, SECTIONS_MAX] {
        let (robot, at) = bent(sections);
        let mut jacobian = Jacobian::default();
        group.bench_function(BenchmarkId::new("position", sections), |bencher| {
            bencher.iter(|| robot.tip_position(black_box(&at)));
        });
        group.bench_function(BenchmarkId::new("jacobian", sections), |bencher| {
            bencher.iter(|| robot.tip_jacobian(black_box(&at), &mut jacobian));
        });
    }
    group.finish();
}

fn clearance(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("clearance");
    let centre_m = Vector3::new(0.15, 0.05, 0.3);
    let sphere = obstacle(Shape::Sphere { centre_m });
    let capsule = obstacle(Shape::Capsule {
        start_m: centre_m,
        end_m: centre_m + Vector3::new(0.0, 0.2, 0.1),
    });
    for sections in [1, 3, SECTIONS_MAX] {
        let (robot, at) = bent(sections);
        let body = robot.body(&at);
        for (name, obstacle) in [("sphere", sphere), ("capsule", capsule)] {
            group.bench_function(BenchmarkId::new(name, sections), |bencher| {
                bencher.iter(|| black_box(&body).clearance_m(black_box(&obstacle)));
            });
        }
    }
    group.finish();
}

criterion_group! {
    name = kernels;
    config = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(800));
    targets = kinematics, clearance
}
criterion_main!(kernels);
