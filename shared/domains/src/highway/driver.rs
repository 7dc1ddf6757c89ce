//! The simulated driver: perceives through LIDAR within sight, remembers, follows (IDM), changes lanes (MOBIL), with
//! delay and noise.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::control::Cockpit;
use super::memory::{CAR_LENGTH_M, Memory};
use super::person::MAX_DELAY;
use super::speech::{Heard, displayable, sector_of};
use super::{
    AZIMUTHS, EGO_LANE_M, EGO_ROAD_M, EGO_SPEED_MPS, Fog, Observation, Person, SECTORS, random,
};

/// Random stream of the simulated driver.
const STREAM: u64 = 2;
/// Seconds after a lane change begins before another is considered at leisure.
const CHANGE_PAUSE_S: f32 = 2.0;
/// Below this time to a collision a person takes whatever lane is better.
const EMERGENCY_S: f32 = 2.5;
/// A car behind that arrives in this time weighs as much as braking comfortably.
const PRESSED_S: f32 = 4.0;
/// This far from the middle of a lane one is past the cars in it.
const CLEAR_M: f32 = 2.1;
/// No lane is entered with less than this to the cars there.
const LEAST_GAP_M: f32 = 1.0;
/// How much harder than necessary a person brakes in need.
const MARGIN: f32 = 1.3;
/// Hardest braking that somebody expects of anybody.
const FULL_BRAKE_MPS2: f32 = 8.0;

/// What a person is shown and told in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// A bit per highlighted sector; only azimuths that a head-up display can show are shown.
    pub highlighted: u32,
    /// Objects with a box around them; −1 for unused places.
    pub highlighted_objects: [i32; 16],
    /// An utterance that starts now, per sector.
    pub utterances: [Option<Heard>; SECTORS],
}

impl Default for Shown {
    fn default() -> Self {
        Self {
            highlighted: 0,
            highlighted_objects: [-1; 16],
            utterances: [None; SECTORS],
        }
    }
}

impl Shown {
    /// Whether the display reveals what the LIDAR sees at an azimuth.
    pub fn reveals(&self, azimuth: usize, object: i32) -> bool {
        displayable(azimuth)
            && (self.highlighted >> sector_of(azimuth) & 1 == 1
                || object >= 0 && self.highlighted_objects.contains(&object))
    }
}

/// A lane as the person judges it.
#[derive(Clone, Copy, Debug)]
struct Prospect {
    /// IDM acceleration behind the car ahead.
    ahead_mps2: f32,
    /// What MOBIL charges for the car behind, negative: see [`SimulatedDriver::prospect`].
    behind_mps2: f32,
    /// Time until the car ahead is met.
    ahead_meet_s: f32,
    /// Time until a car of that lane is met.
    meet_s: f32,
    /// Smallest gap to a car of that lane; negative where one is alongside.
    gap_m: f32,
}

/// A decision on its way from head to hands.
#[derive(Clone, Copy, Debug, Default)]
struct Decision {
    acceleration_mps2: f32,
    lane: usize,
}

/// A simulated person at the wheel.
#[derive(Clone, Debug)]
pub struct SimulatedDriver {
    person: Person,
    cockpit: Cockpit,
    visible_m: [f32; AZIMUTHS],
    memory: Memory,
    random: ChaCha8Rng,
    /// Ring of decisions; the delay is read behind.
    pending: [Decision; MAX_DELAY + 1],
    step: usize,
    lane: usize,
    since_change_s: f32,
    noise: [f32; 2],
}

impl SimulatedDriver {
    /// A person in a fog and a cockpit; call [`SimulatedDriver::reset`] before every round.
    pub fn new(person: &Person, fog: &Fog, cockpit: Cockpit) -> Self {
        Self {
            person: person.clone(),
            cockpit,
            visible_m: person.visibility_m(fog),
            memory: Memory::new(),
            random: random(0, 0, STREAM),
            pending: [Decision::default(); MAX_DELAY + 1],
            step: 0,
            lane: 0,
            since_change_s: CHANGE_PAUSE_S,
            noise: [0.0; 2],
        }
    }

    /// Starts a round. People of different numbers have different noise.
    pub fn reset(&mut self, seed: u64, episode: u32) {
        self.random = random(seed, episode, STREAM | u64::from(self.person.id) << 8);
        self.memory.clear();
        self.step = 0;
        self.since_change_s = CHANGE_PAUSE_S;
        self.noise = [0.0; 2];
    }

    /// Takes other random numbers and keeps the memory: somebody who is the same until now, and whose hands tremble otherwise.
    pub fn reseed(&mut self, seed: u64, episode: u32, stream: u64) {
        self.random = random(seed, episode, stream);
    }

    /// How far this driver sees, per azimuth, in metres.
    pub fn visible_m(&self) -> &[f32; AZIMUTHS] {
        &self.visible_m
    }

    /// The lane that the driver wants to be in, counted from the right.
    pub fn lane(&self) -> usize {
        self.lane
    }

    /// What the person does, seeing their part of `observation` and what is shown and said.
    pub fn act(&mut self, observation: &Observation, shown: &Shown) -> [f32; 2] {
        let cockpit = self.cockpit;
        let speed = observation.ego[1] * EGO_SPEED_MPS;
        let lane_offset = observation.ego[2] * EGO_LANE_M;
        let lane_centre = observation.ego[3] * EGO_ROAD_M - lane_offset;
        let middle = (cockpit.lanes as f32 - 1.0) / 2.0;
        let here = (lane_centre / cockpit.lane_m + middle)
            .round()
            .clamp(0.0, cockpit.lanes as f32 - 1.0) as usize;
        if self.step == 0 {
            self.lane = here;
            self.pending = [Decision {
                acceleration_mps2: 0.0,
                lane: here,
            }; MAX_DELAY + 1];
        }
        self.memory.update(
            &cockpit,
            observation,
            here,
            |azimuth, object, range_m| {
                range_m <= self.visible_m[azimuth] || shown.reveals(azimuth, object)
            },
            &self.visible_m,
        );
        for (sector, heard) in shown.utterances.iter().enumerate() {
            if let Some(heard) = heard {
                self.memory
                    .hear(sector, heard, here, cockpit.lane_m, cockpit.lanes);
            }
        }
        let acceleration_mps2 = self.decide(here, lane_offset, speed);
        self.pending[self.step % (MAX_DELAY + 1)] = Decision {
            acceleration_mps2,
            lane: self.lane,
        };
        let delayed = self
            .step
            .saturating_sub(self.person.reacting.delay_steps as usize);
        let decision = self.pending[delayed % (MAX_DELAY + 1)];
        self.step += 1;
        self.since_change_s += cockpit.step_s;

        let aside = (decision.lane as f32 - here as f32) * cockpit.lane_m - lane_offset;
        let heading_error = observation.ego[0] * std::f32::consts::PI;
        let curvature = observation.ego[4] * std::f32::consts::PI / super::EGO_AHEAD_M as f32;
        let Person {
            changing, reacting, ..
        } = &self.person;
        let steer = cockpit.steer(
            aside,
            heading_error,
            curvature,
            speed,
            1.0,
            changing.slant_rad,
            reacting.turn_s,
        );
        let pedal = cockpit.pedal(decision.acceleration_mps2, speed);
        let kept = reacting.noise_memory;
        let fresh = (1.0 - kept * kept).sqrt();
        for (noise, deviation) in self
            .noise
            .iter_mut()
            .zip([reacting.pedal_noise, reacting.steer_noise])
        {
            let draw: f32 = StandardNormal.sample(&mut self.random);
            *noise = kept * *noise + fresh * deviation * draw;
        }
        [
            (pedal + self.noise[0]).clamp(-1.0, 1.0),
            (steer + self.noise[1]).clamp(-1.0, 1.0),
        ]
    }

    /// Chooses the lane, and the acceleration there.
    fn decide(&mut self, here: usize, lane_offset: f32, speed: f32) -> f32 {
        let settled = here == self.lane && lane_offset.abs() < 0.6;
        let own = self.prospect(self.lane, speed);
        let Person { changing, .. } = &self.person;
        let (politeness, threshold, safe_s) = (
            changing.politeness,
            changing.threshold_mps2,
            changing.safe_s,
        );
        let mut best: Option<(f32, usize)> = None;
        for lane in self.lane.saturating_sub(1)..=(self.lane + 1).min(self.cockpit.lanes - 1) {
            // In the middle of a change, the way back is the only other way.
            if lane == self.lane || !settled && lane != here {
                continue;
            }
            let other = self.prospect(lane, speed);
            // MOBIL: ã − a + p (ã_n − a_n + ã_o − a_o) > Δa; leaving frees the car behind, entering hinders another.
            let gain = other.ahead_mps2 - own.ahead_mps2
                + politeness * (other.behind_mps2 - own.behind_mps2);
            let leisurely = settled
                && self.since_change_s >= CHANGE_PAUSE_S
                && gain > threshold
                && other.meet_s > safe_s
                && other.gap_m > 2.0 * LEAST_GAP_M;
            let emergency = own.meet_s < EMERGENCY_S
                && other.meet_s > own.meet_s + 1.0
                && other.gap_m > LEAST_GAP_M;
            let score = gain + 10.0 * other.meet_s.min(10.0) * f32::from(u8::from(emergency));
            if (leisurely || emergency) && best.is_none_or(|(most, _)| score > most) {
                best = Some((score, lane));
            }
        }
        let mut acceleration = own.ahead_mps2;
        if let Some((_, lane)) = best {
            self.lane = lane;
            self.since_change_s = 0.0;
            acceleration = self.prospect(lane, speed).ahead_mps2;
        }
        if here != self.lane || lane_offset.abs() > 0.9 {
            // Until the old lane is left, its car ahead counts if it would be met before.
            let old = if here != self.lane {
                here
            } else {
                (here as f32 + lane_offset.signum()) as usize
            };
            let old = old.min(self.cockpit.lanes - 1);
            let gone_m = (here as f32 - old as f32).abs() * self.cockpit.lane_m
                + if old == here {
                    lane_offset.abs()
                } else {
                    -lane_offset.abs()
                };
            let aside_mps = 0.7 * changing.slant_rad * speed.max(2.0);
            let leave_s = (CLEAR_M - gone_m).max(0.0) / aside_mps
                + if old == here {
                    self.person.reacting.delay_steps as f32 * self.cockpit.step_s
                } else {
                    0.0
                };
            let old = self.prospect(old, speed);
            if leave_s > 0.0 && old.ahead_meet_s < leave_s + 0.3 {
                acceleration = acceleration.min(old.ahead_mps2);
            }
        }
        acceleration
    }

    /// Judges a lane: IDM towards the car ahead, and pressure from the car behind. Cars behind do not brake for anybody
    /// here, so that what counts is not the deceleration that IDM would expect of them but the time until they arrive:
    /// −b (τ / t)², with [`PRESSED_S`] as τ.
    fn prospect(&self, lane: usize, speed: f32) -> Prospect {
        let following = &self.person.following;
        let blind = 1.0 - self.visible_m[0] / super::LIDAR_RANGE_M;
        let desired =
            self.cockpit.pace * following.desired_kmh / 3.6 * (1.0 - following.caution * blind);
        let bumpers = CAR_LENGTH_M / 2.0 + self.cockpit.half_length_m;
        let mut prospect = Prospect {
            ahead_mps2: following.acceleration_mps2 * (1.0 - (speed / desired).powi(4)),
            behind_mps2: 0.0,
            ahead_meet_s: f32::INFINITY,
            meet_s: f32::INFINITY,
            gap_m: f32::INFINITY,
        };
        let free = prospect.ahead_mps2;
        let interaction = |gap: f32, follower: f32, leader: f32| {
            let comfort = 2.0 * (following.acceleration_mps2 * following.deceleration_mps2).sqrt();
            let wanted = following.standstill_m
                + (follower * following.headway_s + follower * (follower - leader) / comfort)
                    .max(0.0);
            following.acceleration_mps2 * (wanted / gap.max(0.1)).powi(2)
        };
        for car in self.memory.cars() {
            if car.lane != lane {
                continue;
            }
            let gap = car.x_m.abs() - bumpers;
            prospect.gap_m = prospect.gap_m.min(gap);
            let closing = if car.x_m >= 0.0 {
                speed - car.speed_mps
            } else {
                car.speed_mps - speed
            };
            let meet_s = match (gap <= 0.0, closing > 0.0) {
                (true, _) => 0.0,
                (false, true) => gap / closing,
                (false, false) => f32::INFINITY,
            };
            prospect.meet_s = prospect.meet_s.min(meet_s);
            if car.x_m >= 0.0 {
                // IDM brakes for the gap that it would like; nobody brakes much harder than it takes not to touch.
                let needed =
                    closing.max(0.0).powi(2) / (2.0 * (gap - following.standstill_m).max(0.5));
                let least = -(MARGIN * needed + following.deceleration_mps2 / 2.0);
                let slowed = (free - interaction(gap, speed, car.speed_mps)).max(least);
                prospect.ahead_meet_s = prospect.ahead_meet_s.min(meet_s);
                prospect.ahead_mps2 = prospect.ahead_mps2.min(slowed.max(-FULL_BRAKE_MPS2));
            } else {
                let pressed = -following.deceleration_mps2 * (PRESSED_S / meet_s.max(0.1)).powi(2);
                prospect.behind_mps2 = prospect.behind_mps2.min(pressed.max(-FULL_BRAKE_MPS2));
            }
        }
        prospect
    }
}

#[cfg(test)]
mod tests;
