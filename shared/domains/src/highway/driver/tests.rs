//! What a simulated driver makes of what they see, are shown and hear.

use super::*;
use crate::highway::{HEIGHT_BANDS, LIDAR_RANGE_M, UtteranceKind};

const COCKPIT: Cockpit = Cockpit {
    lane_m: 3.5,
    lanes: 2,
    wheelbase_m: 2.85,
    half_length_m: 2.35,
    steer_rad: 0.35,
    acceleration_mps2: 3.5,
    brake_mps2: 8.0,
    drag_mps2: 0.3,
    step_s: 0.15,
    pace: 1.0,
};

fn driver(id: u32, fog: &Fog) -> SimulatedDriver {
    let mut driver = SimulatedDriver::new(&Person::builtin(id).unwrap(), fog, COCKPIT);
    driver.reset(3, 1);
    driver
}

/// In the middle of the right lane at 36 km/h.
fn cruising() -> Observation {
    let mut observation = Observation {
        moving: true,
        ..Observation::default()
    };
    observation.ego = [0.0, 0.9, 0.0, -1.75 / EGO_ROAD_M, 0.0];
    observation
}

fn with_car(
    mut observation: Observation,
    azimuth: usize,
    range_m: f32,
    speed_mps: f32,
) -> Observation {
    for band in 0..HEIGHT_BANDS {
        observation.range[band * AZIMUTHS + azimuth] = range_m / LIDAR_RANGE_M;
    }
    observation.object[azimuth] = 7;
    observation.speed_mps[azimuth] = speed_mps;
    observation
}

#[test]
fn what_lies_beyond_sight_changes_nothing() {
    let fog = Fog::new(15.0, 8.0, 3.0);
    for id in 1..=Person::COUNT {
        let visible = driver(id, &fog).visible_m;
        for azimuth in 0..AZIMUTHS {
            let (mut alone, mut beside) = (driver(id, &fog), driver(id, &fog));
            let hidden = with_car(cruising(), azimuth, visible[azimuth] + 0.1, 1.0);
            for _ in 0..20 {
                let shown = Shown::default();
                assert_eq!(
                    alone.act(&cruising(), &shown),
                    beside.act(&hidden, &shown),
                    "{id} {azimuth}"
                );
            }
        }
    }
}

#[test]
fn a_slow_car_in_sight_is_left_behind() {
    for id in 1..=Person::COUNT {
        let mut driver = driver(id, &Fog::clear());
        let ahead = with_car(cruising(), 0, 25.0, 1.0);
        for _ in 0..10 {
            driver.act(&ahead, &Shown::default());
        }
        assert_eq!(driver.lane(), 1, "person {id} stays behind");
    }
}

#[test]
fn a_highlight_reveals_ahead_but_not_behind() {
    let fog = Fog::new(15.0, 8.0, 3.0);
    for id in 1..=Person::COUNT {
        let shown = Shown {
            highlighted: 0b111111,
            ..Shown::default()
        };
        let (mut ahead, mut behind) = (driver(id, &fog), driver(id, &fog));
        for _ in 0..10 {
            ahead.act(&with_car(cruising(), 0, 30.0, 1.0), &shown);
            behind.act(&with_car(cruising(), 18, 20.0, 19.0), &shown);
        }
        assert_eq!((ahead.lane(), behind.lane()), (1, 0), "person {id}");
    }
}

#[test]
fn who_hears_of_a_rusher_makes_way() {
    let fog = Fog::new(15.0, 8.0, 3.0);
    for id in 1..=Person::COUNT {
        let mut driver = driver(id, &fog);
        let mut shown = Shown::default();
        shown.utterances[3] = Some(Heard {
            kind: UtteranceKind::Fast,
            range_m: 30.0,
            speed_mps: 18.0,
        });
        driver.act(&cruising(), &shown);
        for _ in 0..6 {
            driver.act(&cruising(), &Shown::default());
        }
        assert_eq!(driver.lane(), 1, "person {id} stays in the rusher's way");
    }
}

#[test]
fn who_hears_of_a_rusher_on_the_left_does_not_go_there() {
    let fog = Fog::new(15.0, 8.0, 3.0);
    for id in 1..=Person::COUNT {
        let mut driver = driver(id, &fog);
        let mut shown = Shown::default();
        shown.utterances[2] = Some(Heard {
            kind: UtteranceKind::Fast,
            range_m: 22.0,
            speed_mps: 18.0,
        });
        driver.act(&with_car(cruising(), 0, 14.0, 6.0), &shown);
        for _ in 0..3 {
            driver.act(&with_car(cruising(), 0, 12.0, 6.0), &Shown::default());
        }
        assert_eq!(driver.lane(), 0, "person {id} goes left");
    }
}

#[test]
fn hearing_that_nothing_is_there_clears_the_mind() {
    let fog = Fog::new(15.0, 8.0, 3.0);
    let mut driver = driver(1, &fog);
    let mut shown = Shown::default();
    shown.utterances[3] = Some(Heard {
        kind: UtteranceKind::Slow,
        range_m: 30.0,
        speed_mps: 8.0,
    });
    driver.act(&cruising(), &shown);
    assert_eq!(driver.memory.cars().len(), 1);
    shown.utterances[3] = Some(Heard {
        kind: UtteranceKind::Nothing,
        range_m: 40.0,
        speed_mps: 0.0,
    });
    driver.act(&cruising(), &shown);
    assert_eq!(driver.memory.cars().len(), 0);
}

#[test]
fn the_same_seed_gives_the_same_hands() {
    let drive = |seed| {
        let mut driver = SimulatedDriver::new(&Person::builtin(4).unwrap(), &Fog::clear(), COCKPIT);
        driver.reset(seed, 9);
        (0..50)
            .map(|_| driver.act(&cruising(), &Shown::default()).map(f32::to_bits))
            .collect::<Vec<_>>()
    };
    assert_eq!(drive(1), drive(1));
    assert_ne!(drive(1), drive(2));
}
