//! The six cases, and the traffic drawn for them.

use rand::RngExt;

use super::STREAM;
use crate::highway::random;
use crate::highway::scene::Traffic;
use crate::highway::traffic::{Kind, LaneMotion, Motion, Participant};

/// What goes wrong in a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misbehaviour {
    /// The car ahead in the ego car's lane slows down.
    FrontSlows,
    /// The car behind in the ego car's lane rushes.
    RearRushes,
    /// The car behind in the other lane rushes.
    OtherRearRushes,
}

/// One of the six cases, 1 to 6: (1) ego left, left-front slows; (2) ego left, left-rear rushes; (3) ego left, right-rear
/// rushes; (4–6) the mirror images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Case(u32);

impl Case {
    /// All of them.
    pub const ALL: [Self; 6] = [Self(1), Self(2), Self(3), Self(4), Self(5), Self(6)];

    /// The case of that number, 1 to 6.
    pub fn new(number: u32) -> Option<Self> {
        (1..=6).contains(&number).then_some(Self(number))
    }

    /// Its number, 1 to 6.
    pub fn number(self) -> u32 {
        self.0
    }

    /// Whether the ego car starts in the left lane.
    pub fn ego_left(self) -> bool {
        self.0 <= 3
    }

    /// What happens.
    pub fn misbehaviour(self) -> Misbehaviour {
        match (self.0 - 1) % 3 {
            0 => Misbehaviour::FrontSlows,
            1 => Misbehaviour::RearRushes,
            _ => Misbehaviour::OtherRearRushes,
        }
    }
}

/// Cars of a case: identities 0 left-rear, 1 right-rear, 2 left-front, 3 right-front, then the scene's extra cars.
pub(super) fn draw_traffic(
    traffic: &Traffic,
    seed: u64,
    episode: u32,
    case: Case,
    participants: &mut Vec<Participant>,
) {
    let mut random = random(seed, episode, STREAM);
    let mut draw = |[low, high]: [f64; 2]| low + (high - low) * random.random::<f64>();
    let reference = traffic.reference_kmh / 3.6;
    // Everything is drawn whether the case uses it or not, so that cases of one seed differ in nothing else.
    let starts: [f64; 4] = [
        draw(traffic.rear_s_m),
        draw(traffic.rear_s_m),
        draw(traffic.front_s_m),
        draw(traffic.front_s_m),
    ];
    let rush = draw(traffic.rush_factor) * reference;
    let (slows_at_m, slow) = (
        draw(traffic.slow_s_m),
        draw(traffic.slow_factor) * reference,
    );
    let ego_lane = usize::from(case.ego_left());
    let car = |id: usize, lane: usize, start_s_m: f64, speed_mps: f64| Participant {
        id: id as i32,
        length_m: traffic.length_m,
        width_m: traffic.width_m,
        kind: Kind::Car,
        motion: Motion::Lane(LaneMotion {
            lane,
            start_s_m,
            speed_mps,
            slows_at_m: f64::INFINITY,
            slow_speed_mps: speed_mps,
            acceleration_mps2: traffic.acceleration_mps2,
            deceleration_mps2: traffic.deceleration_mps2,
            delay_s: 0.0,
        }),
    };
    for (id, start_s_m) in starts.into_iter().enumerate() {
        // Lane 1 is the left one.
        let lane = 1 - id % 2;
        let rear = id < 2;
        let factor = if rear {
            traffic.rear_factor
        } else {
            traffic.front_factor
        };
        let mut drawn = car(id, lane, start_s_m, factor * reference);
        if let Motion::Lane(motion) = &mut drawn.motion {
            let own = lane == ego_lane;
            match case.misbehaviour() {
                Misbehaviour::FrontSlows if !rear && own => {
                    (motion.slows_at_m, motion.slow_speed_mps) = (slows_at_m, slow);
                }
                Misbehaviour::RearRushes if rear && own => {
                    (motion.speed_mps, motion.acceleration_mps2) =
                        (rush, traffic.rush_acceleration_mps2);
                }
                Misbehaviour::OtherRearRushes if rear && !own => {
                    (motion.speed_mps, motion.acceleration_mps2) =
                        (rush, traffic.rush_acceleration_mps2);
                }
                _ => {}
            }
        }
        participants.push(drawn);
    }
    for (index, extra) in traffic.extra.iter().enumerate() {
        participants.push(car(
            4 + index,
            extra.lane,
            extra.start_s_m,
            extra.speed_kmh / 3.6,
        ));
    }
}
