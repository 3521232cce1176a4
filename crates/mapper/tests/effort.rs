//! What work the mapper says that it did: every piece once, and the same at any number of threads.

#![allow(clippy::unwrap_used)]

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};

use echosplat_mapper::{Counted, Mapper, MapperConfig, MapperStatus, Task, TaskCounts};
use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};

/// Status at the end of a dive, and what was told on the way.
fn mapped(threads: usize) -> (MapperStatus, TaskCounts) {
    let scene = Arc::new(Scene::named("fence").unwrap());
    let options = DiveOptions {
        duration_s: 20.0,
        ..DiveOptions::default()
    };
    let noise = NoiseLevel::Nominal;
    let dive = Dive::plan_with(DiveKind::Survey, &scene, noise, 7, &options).unwrap();
    let dive = Arc::new(dive);
    let sonar = SimulatedSonar::new(scene, dive.clone(), noise, 7);
    let trajectory = dive.trajectory(0.5);
    let mut mapper = Mapper::new(MapperConfig {
        threads,
        workout_passes: 8,
        history_pings: 600,
        ..MapperConfig::default()
    })
    .unwrap();
    let told = Arc::new(Mutex::new(TaskCounts::default()));
    let (to, under_way) = (told.clone(), Arc::new(AtomicI64::new(0)));
    mapper.on_task(move |task| {
        assert_eq!(
            under_way.fetch_add(1, Ordering::Relaxed),
            0,
            "{task:?} within another"
        );
        let (to, under_way) = (to.clone(), under_way.clone());
        Box::new(move |counted| {
            under_way.fetch_sub(1, Ordering::Relaxed);
            to.lock().unwrap().add(task, counted);
        })
    });
    for ping in (0..dive.pings()).filter_map(|index| sonar.posed_ping(index, &trajectory)) {
        mapper.insert(&ping);
    }
    mapper.finish();
    let told = *told.lock().unwrap();
    (mapper.status(), told)
}

#[test]
fn what_is_counted_adds_up_is_told_and_is_the_same_at_any_number_of_threads() {
    let (status, told) = mapped(1);
    let of = status.tasks;
    assert_eq!(of, told);
    let (two, _) = mapped(2);
    assert_eq!(of, two.tasks);
    let sum = |what: fn(&Counted) -> u64| {
        Task::ALL
            .into_iter()
            .map(|task| what(&of[task]))
            .sum::<u64>()
    };
    assert_eq!(
        sum(|counted| counted.voxel_looks),
        status.voxel_observations
    );
    let sampled = of[Task::Begin].pairs;
    assert_eq!(sum(|counted| counted.pairs), status.pairs + sampled);
    assert_eq!(of[Task::Detect].visits, status.pings - status.pings_deaf);
    for task in Task::ALL {
        let Counted {
            times,
            visits,
            candidates,
            pairs,
            ..
        } = of[task];
        let is_rare = [Task::Anew, Task::Compare].contains(&task);
        assert!(times > 0 || is_rare, "{task:?}");
        match task {
            Task::Strengthen | Task::Localise | Task::Assess | Task::Forget => {
                assert!(
                    visits > 0 && candidates >= visits && pairs > candidates,
                    "{task:?}"
                );
            }
            Task::Judge | Task::Change | Task::Snapshot => {
                assert!(visits == 0 && candidates > 0, "{task:?}");
            }
            _ => {}
        }
    }
}
