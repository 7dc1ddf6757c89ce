//! Properties over drawn inputs: readers never panic, projection inverts placing, boxes and beams agree with brute force.

use std::path::Path;

use domains::highway::geometry::OrientedBox;
use domains::highway::lidar::Lidar;
use domains::highway::road::{LaneEdges, RoadPoint, Segment};
use domains::highway::traffic::CarState;
use domains::highway::{AZIMUTHS, FileError, Observation, Person, Road, Scene};
use proptest::prelude::*;

const FOG_SCENE: &str = include_str!("../../../launch/scenes/highway-fog.toml");
const PERSON: &str = include_str!("../people/highway/07.toml");

fn oriented_box() -> impl Strategy<Value = OrientedBox> {
    (
        -8.0..8.0f64,
        -8.0..8.0f64,
        -3.2..3.2f64,
        0.3..5.0f64,
        0.3..2.0f64,
    )
        .prop_map(
            |(x_m, y_m, heading, half_length_m, half_width_m)| OrientedBox {
                x_m,
                y_m,
                cos: heading.cos(),
                sin: heading.sin(),
                half_length_m,
                half_width_m,
            },
        )
}

fn inside(shape: &OrientedBox, x: f64, y: f64, slack: f64) -> bool {
    let (dx, dy) = (x - shape.x_m, y - shape.y_m);
    let (along, across) = (
        dx * shape.cos + dy * shape.sin,
        dy * shape.cos - dx * shape.sin,
    );
    along.abs() <= shape.half_length_m + slack && across.abs() <= shape.half_width_m + slack
}

/// Points all over a box, edges and corners included.
fn points(shape: OrientedBox) -> impl Iterator<Item = (f64, f64)> {
    const N: i32 = 60;
    (-N..=N).flat_map(move |i| {
        (-N..=N).map(move |j| {
            let (along, across) = (
                f64::from(i) / f64::from(N) * shape.half_length_m,
                f64::from(j) / f64::from(N) * shape.half_width_m,
            );
            (
                shape.x_m + along * shape.cos - across * shape.sin,
                shape.y_m + along * shape.sin + across * shape.cos,
            )
        })
    })
}

fn car() -> impl Strategy<Value = CarState> {
    (
        oriented_box(),
        -38.0..38.0f64,
        -38.0..38.0f64,
        any::<bool>(),
        0.0..20.0f64,
    )
        .prop_map(|(shape, x_m, y_m, tall, speed_mps)| CarState {
            x_m,
            y_m,
            cos: shape.cos,
            sin: shape.sin,
            half_length_m: 1.5 + shape.half_length_m,
            half_width_m: 0.5 + shape.half_width_m,
            tall,
            speed_mps,
            present: true,
            ..CarState::default()
        })
}

proptest! {
    #[test]
    fn random_bytes_are_refused_politely(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let folder = std::env::temp_dir().join(format!("mirror-domains-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("scene.toml");
        std::fs::write(&file, &bytes).unwrap();
        for error in [Scene::load(&file).err(), Person::load(&file).err()].into_iter().flatten() {
            prop_assert!(error.to_string().contains("scene.toml"), "{error}");
        }
    }

    #[test]
    fn damaged_files_never_panic(cut in 0usize..4000, at in 0usize..4000, byte in 32u8..127) {
        for text in [FOG_SCENE, PERSON] {
            let mut bytes = text.as_bytes()[..text.len().min(cut.max(1))].to_vec();
            let place = at % bytes.len();
            bytes[place] = byte;
            let text = String::from_utf8_lossy(&bytes).into_owned();
            for error in [
                Scene::from_toml(Path::new("damaged"), &text).err(),
                Person::from_toml(Path::new("damaged"), &text).err(),
            ].into_iter().flatten() {
                prop_assert!(error.to_string().starts_with("damaged"), "{error}");
            }
        }
    }

    #[test]
    fn any_numbers_make_a_road_or_an_error(
        segments in proptest::collection::vec((any::<f64>(), any::<f64>()), 0..4),
        lanes in 0usize..15,
        width in any::<f64>(),
    ) {
        let segments: Vec<Segment> = segments
            .into_iter()
            .map(|(length_m, curvature_per_m)| Segment { length_m, curvature_per_m })
            .collect();
        let _ = Road::from_segments(&segments, lanes, width, 1.0, 1.0);
    }

    #[test]
    fn projection_inverts_placing(s in 0.0..468.0f64, d in -9.0..9.0f64, off in -3.0..3.0f64) {
        let road = Scene::default().road.build().unwrap();
        let (x, y, tx, ty) = road.place(s, d);
        prop_assert!((tx.hypot(ty) - 1.0).abs() < 1e-12);
        for found in [road.project(x, y), road.project_near(x, y, s + off)] {
            prop_assert!((found.s_m - s).abs() < 1e-3 && (found.d_m - d).abs() < 1e-3, "{found:?} for {s} {d}");
        }
        let pose = road.pose(RoadPoint { s_m: s, d_m: d });
        prop_assert!((pose.heading_rad - road.heading_rad(s)).abs() < 1e-3);
    }

    #[test]
    fn overlap_is_symmetric_and_true(a in oriented_box(), b in oriented_box()) {
        prop_assert_eq!(a.overlaps(&b), b.overlaps(&a));
        // Crossing boxes need not contain each other's corners, so that both are filled with points. Two boxes that share
        // less than a grid cell may be missed.
        let touching = points(a).any(|(x, y)| inside(&b, x, y, 0.0)) || points(b).any(|(x, y)| inside(&a, x, y, 0.0));
        if touching {
            prop_assert!(a.overlaps(&b));
        } else if a.overlaps(&b) {
            let almost = points(a).any(|(x, y)| inside(&b, x, y, 0.15));
            prop_assert!(almost, "{:?} {:?}", a, b);
        }
    }

    #[test]
    fn beams_agree_with_brute_force(cars in proptest::collection::vec(car(), 1..6), heading in -3.1..3.1f64) {
        let lidar = Lidar::default();
        let mut seen = Observation::default();
        Lidar::clear(&mut seen);
        let (sin, cos) = heading.sin_cos();
        let cars: Vec<CarState> =
            cars.into_iter().enumerate().map(|(id, car)| CarState { id: id as i32, ..car }).collect();
        for car in &cars {
            lidar.cast(0.0, 0.0, cos, sin, car, &mut seen);
        }
        for azimuth in 0..AZIMUTHS {
            let angle = heading + azimuth as f64 * std::f64::consts::TAU / AZIMUTHS as f64;
            let (ux, uy) = (angle.cos(), angle.sin());
            // Walk along the beam in centimetres until something is there.
            for band in 0..3 {
                let range_m = f64::from(seen.range[band * AZIMUTHS + azimuth]) * 40.0;
                let shapes: Vec<OrientedBox> = cars.iter().map(|car| silhouette(car, band)).collect();
                let walked = (0..4000)
                    .map(|step| f64::from(step) * 0.01)
                    .find(|&r| shapes.iter().any(|shape| inside(shape, r * ux, r * uy, 0.0)));
                // A corner grazed between two steps of the walk is seen by the beam only.
                if let Some(walked) = walked {
                    prop_assert!(range_m < walked + 0.001, "{azimuth} {band}: {range_m} {walked}");
                }
                if range_m < 40.0 {
                    let real = shapes.iter().any(|shape| inside(shape, range_m * ux, range_m * uy, 0.001));
                    prop_assert!(real, "a return from nowhere");
                }
            }
            let object = seen.object[azimuth];
            prop_assert_eq!(object >= 0, seen.nearest_m(azimuth) < 40.0);
            if let Some(car) = cars.iter().find(|car| car.id == object) {
                prop_assert_eq!(seen.speed_mps[azimuth], car.speed_mps as f32);
                let near = f64::from(seen.nearest_m(azimuth));
                let hit = (0..3).any(|band| inside(&silhouette(car, band), near * ux, near * uy, 0.001));
                prop_assert!(hit, "the object named is not the nearest");
            }
        }
    }
}

/// Stated again, independently of the library: bumpers, body, cabin.
fn silhouette(car: &CarState, band: usize) -> OrientedBox {
    let (length, width, back) = match (car.tall, band) {
        (true, _) | (_, 0) => (1.0, 1.0, 0.0),
        (_, 1) => (0.96, 1.0, 0.0),
        _ => (0.55, 0.85, 0.08),
    };
    OrientedBox {
        x_m: car.x_m - back * 2.0 * car.half_length_m * car.cos,
        y_m: car.y_m - back * 2.0 * car.half_length_m * car.sin,
        cos: car.cos,
        sin: car.sin,
        half_length_m: car.half_length_m * length,
        half_width_m: car.half_width_m * width,
    }
}

#[test]
fn errors_name_file_and_place() {
    let parse = |text: &str| {
        Scene::from_toml(Path::new("a.toml"), text)
            .unwrap_err()
            .to_string()
    };
    assert!(
        parse("name = \"x\"\n[road]\nlanez = 2\n").starts_with("a.toml:3:1: unknown field `lanez`")
    );
    assert!(parse("[ego]\nwidth_m = \"wide\"\n").starts_with("a.toml:2:11: "));
    assert!(
        parse("[ego]\nwidth_m = 9.0\n").starts_with("a.toml: ego.width_m is 9, expected 1 to 3")
    );
    assert!(parse("[ego]\nwidth_m = nan\n").contains("ego.width_m is NaN"));
    assert!(
        parse("[road]\nsegments = [{ length_m = -1.0 }]\n")
            .starts_with("a.toml: [road]: length of segment 1")
    );
    assert!(parse("[traffic]\ncase = 7\n").contains("traffic.case is 7, expected 1 to 6"));
    assert!(matches!(
        Scene::builtin("nowhere"),
        Err(FileError::Unknown { .. })
    ));
    assert!(matches!(
        Scene::load(Path::new("/no/such/file.toml")),
        Err(FileError::Read { .. })
    ));
    let error = Person::from_toml(Path::new("p.toml"), "id = 1\n")
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("p.toml:") && error.contains("sight"),
        "{error}"
    );
    assert!(Person::builtin(0).is_err() && Person::builtin(22).is_err());
}

#[test]
fn shipped_scenes_are_the_documented_defaults() {
    let clear = Scene::builtin("highway-clear").unwrap();
    assert_eq!(clear, Scene::default());
    let fog = Scene::builtin("highway-fog").unwrap();
    assert!(fog.fog.is_some());
    assert_eq!(
        Scene {
            name: clear.name.clone(),
            fog: None,
            ..fog.clone()
        },
        clear,
        "every key of the fog scene"
    );
    // --fog with the scene's own distance changes nothing, in clear weather it gives the fog scene's fog.
    let mut same = clear;
    same.set_fog_m(fog.fog.unwrap().front_m);
    assert_eq!(same.fog, fog.fog);
    same.set_fog_m(30.0);
    assert_eq!(same.fog.unwrap().front_m, 30.0);
}

#[test]
fn people_see_less_in_fog_and_least_behind() {
    let fog = Scene::builtin("highway-fog").unwrap().fog();
    for id in 1..=Person::COUNT {
        let person = Person::builtin(id).unwrap();
        let (clear, foggy) = (
            person.visibility_m(&domains::highway::Fog::clear()),
            person.visibility_m(&fog),
        );
        for azimuth in 0..AZIMUTHS {
            assert!(foggy[azimuth] <= clear[azimuth] && clear[azimuth] <= 40.0);
        }
        assert_eq!(clear[0], 40.0);
        assert!(
            foggy[18] < foggy[9] && foggy[9] < foggy[0],
            "person {id}: {foggy:?}"
        );
    }
}

#[test]
fn lanes_from_polylines_are_where_they_were_drawn() {
    let bend = |s: f64, d: f64| {
        let (radius, angle) = (300.0, s / 300.0);
        [
            (radius - d) * angle.sin(),
            radius - (radius - d) * angle.cos(),
        ]
    };
    let line = |d: f64, from: i32, to: i32| {
        (from..=to)
            .map(|i| bend(f64::from(i) * 5.0, d))
            .collect::<Vec<_>>()
    };
    let lane = |middle: f64, from, to| LaneEdges {
        left: line(middle + 1.8, from, to),
        right: line(middle - 1.8, from, to),
    };
    // Given out of order; the third is a ramp that ends at 100 m.
    let road = Road::from_polylines(
        &line(0.0, 0, 40),
        &[lane(1.8, 0, 40), lane(-1.8, 0, 40), lane(-5.4, 0, 20)],
        3.0,
        2.0,
    )
    .unwrap();
    assert!((road.length_m() - 200.0).abs() < 0.05);
    for s in [20.0, 60.0, 95.0] {
        for (index, middle) in [-5.4, -1.8, 1.8].into_iter().enumerate() {
            assert!((road.lane_offset_m(index, s) - middle).abs() < 0.03);
            assert!((road.lane_width_m(index, s) - 3.6).abs() < 0.05);
            assert_eq!(
                road.lane_near(RoadPoint {
                    s_m: s,
                    d_m: middle + 0.5
                }),
                index
            );
        }
    }
    assert_eq!(
        road.lane_near(RoadPoint {
            s_m: 150.0,
            d_m: -5.0
        }),
        1,
        "the ramp has ended"
    );
    let (right, left) = road.edges_m(150.0);
    assert!((right + 3.6).abs() < 0.05 && (left - 3.6).abs() < 0.05);
    assert!((road.edges_m(50.0).0 + 7.2).abs() < 0.05);
    assert!((road.turn_ahead_rad(100.0, 30.0) - 0.1).abs() < 0.003);
    assert!(Road::from_polylines(&[[0.0, 0.0]], &[], 0.0, 0.0).is_err());
    assert!(Road::from_polylines(&line(0.0, 0, 40), &[], 0.0, 0.0).is_err());
    assert!(Road::from_polylines(&[[0.0, f64::NAN], [1.0, 0.0]], &[], 0.0, 0.0).is_err());
}
