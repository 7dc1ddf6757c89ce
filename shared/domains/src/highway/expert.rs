//! An expert for imitation in training: it tries a few manoeuvres in its head and takes the best. It sees everything and knows what
//! everybody is going to do ([`Expert::act`]), or sees only so far, remembers for a while, and takes speeds to stay as they are
//! ([`Expert::act_within`]): a teacher for those who see no more.

use super::control::Cockpit;
use super::traffic::Motion;
use super::world::World;
use super::{AZIMUTHS, EGO_AHEAD_M, road::wrap_angle};

/// Seconds that a manoeuvre is imagined for; long enough to see a rusher from 60 m behind arrive.
const HORIZON_S: f64 = 7.5;
/// Time step of imagination.
const STEP_S: f64 = 0.25;
/// Speeds that it considers.
const SPEEDS_MPS: [f64; 4] = [37.5 / 3.6, 8.0, 4.0, 0.0];
/// How long it considers waiting before a lane change.
const DELAYS_S: [f64; 3] = [0.0, 1.25, 2.5];
/// Sideways speed of an imagined lane change.
const ASIDE_MPS: f64 = 1.5;
/// Space that it keeps to other cars.
const MARGIN_M: [f64; 2] = [2.0, 0.4];
/// Most cars that it considers, nearest lanes first.
const MAX_CARS: usize = 64;
/// For how many control steps a car that is out of sight is reckoned on.
const REMEMBERED_STEPS: u32 = 20;

/// A car that was seen.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    id: i32,
    s: f64,
    d: f64,
    speed: f64,
    half_length: f64,
    half_width: f64,
    unseen: u32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Imagined {
    s: f64,
    d: f64,
    speed: f64,
    slows_at: f64,
    slow: f64,
    cruise: f64,
    acceleration: f64,
    deceleration: f64,
    half_length: f64,
    half_width: f64,
}

/// The expert driver.
#[derive(Clone, Debug)]
pub struct Expert {
    cockpit: Cockpit,
    lane: usize,
    cars: [Imagined; MAX_CARS],
    count: usize,
    known: [Known; MAX_CARS],
    knows: usize,
}

impl Expert {
    /// An expert for a world.
    pub fn new(world: &World) -> Self {
        let cockpit = Cockpit::new(world.scene(), world.road(), world.ego().at.s_m);
        Self {
            cockpit,
            lane: world.ego().lane,
            cars: [Imagined::default(); MAX_CARS],
            count: 0,
            known: [Known::default(); MAX_CARS],
            knows: 0,
        }
    }

    /// Prepares for a new round of the same world.
    pub fn reset(&mut self, world: &World) {
        *self = Self::new(world);
    }

    /// The action it takes now, seeing everything.
    pub fn act(&mut self, world: &World) -> [f32; 2] {
        self.look(world);
        self.choose(world)
    }

    /// The action that it takes now if it sees no car farther than `visible_m` in each azimuth. One expert has one sight in a round.
    pub fn act_within(&mut self, world: &World, visible_m: &[f32; AZIMUTHS]) -> [f32; 2] {
        self.remember(world, visible_m);
        self.choose(world)
    }

    fn choose(&mut self, world: &World) -> [f32; 2] {
        let ego = *world.ego();
        let road = world.road();
        let mut best = (f64::NEG_INFINITY, self.lane, SPEEDS_MPS[0]);
        for lane in self.lane.saturating_sub(1)..=(self.lane + 1).min(road.lanes().len() - 1) {
            let delays: &[f64] = if lane == self.lane {
                &DELAYS_S[..1]
            } else {
                &DELAYS_S
            };
            for &delay in delays {
                for speed in SPEEDS_MPS {
                    let mut value = self.imagine(world, lane, delay, speed);
                    // What is being done already is worth a little: no dithering between equals.
                    if lane == self.lane {
                        value += 1.0;
                    }
                    if value > best.0 {
                        best = (value, if delay == 0.0 { lane } else { self.lane }, speed);
                    }
                }
            }
        }
        self.lane = best.1;
        let s = ego.at.s_m;
        let aside = road.lane_offset_m(self.lane, s) - ego.at.d_m;
        let error = wrap_angle(ego.pose.heading_rad - road.heading_rad(s));
        let curvature = road.turn_ahead_rad(s, EGO_AHEAD_M / 2.0) / (EGO_AHEAD_M / 2.0);
        let speed = ego.speed_mps as f32;
        let steer = self.cockpit.steer(
            aside as f32,
            error as f32,
            curvature as f32,
            speed,
            0.8,
            0.25,
            0.4,
        );
        let acceleration = ((best.2 - ego.speed_mps) / 0.4).clamp(-7.0, 4.0) as f32;
        [self.cockpit.pedal(acceleration, speed), steer]
    }

    /// Notes the cars within reach of the horizon, with what they are going to do.
    fn look(&mut self, world: &World) {
        self.count = 0;
        let here = world.ego().at.s_m;
        for (car, participant) in world.objects().iter().zip(world.participants()) {
            if !car.present || (car.at.s_m - here).abs() > 160.0 || self.count == MAX_CARS {
                continue;
            }
            let mut imagined = Imagined {
                s: car.at.s_m,
                d: car.at.d_m,
                speed: car.speed_mps,
                slows_at: f64::INFINITY,
                cruise: car.speed_mps,
                slow: car.speed_mps,
                acceleration: 3.0,
                deceleration: 4.0,
                half_length: car.half_length_m,
                half_width: car.half_width_m,
            };
            if let Motion::Lane(motion) = &participant.motion {
                imagined.slows_at = motion.slows_at_m;
                imagined.cruise = motion.speed_mps;
                imagined.slow = motion.slow_speed_mps;
                imagined.acceleration = motion.acceleration_mps2;
                imagined.deceleration = motion.deceleration_mps2;
            }
            self.cars[self.count] = imagined;
            self.count += 1;
        }
    }

    /// Notes the cars in sight, and reckons on those that were.
    fn remember(&mut self, world: &World, visible_m: &[f32; AZIMUTHS]) {
        let observation = world.observation();
        let step_s = f64::from(self.cockpit.step_s);
        for known in &mut self.known[..self.knows] {
            known.s += known.speed * step_s;
            known.unseen += 1;
        }
        for car in world.objects().iter().filter(|car| car.present) {
            let is_seen = (0..AZIMUTHS).any(|azimuth| {
                observation.object[azimuth] == car.id
                    && observation.nearest_m(azimuth) <= visible_m[azimuth]
            });
            if !is_seen {
                continue;
            }
            let known = self.known[..self.knows].iter().position(|k| k.id == car.id);
            let place = known.unwrap_or(self.knows);
            if place == MAX_CARS {
                continue;
            }
            self.knows = self.knows.max(place + 1);
            self.known[place] = Known {
                id: car.id,
                s: car.at.s_m,
                d: car.at.d_m,
                speed: car.speed_mps,
                half_length: car.half_length_m,
                half_width: car.half_width_m,
                unseen: 0,
            };
        }
        let mut kept = 0;
        for k in 0..self.knows {
            if self.known[k].unseen <= REMEMBERED_STEPS {
                self.known[kept] = self.known[k];
                kept += 1;
            }
        }
        self.knows = kept;
        self.count = kept;
        for (imagined, known) in self.cars.iter_mut().zip(&self.known[..kept]) {
            *imagined = Imagined {
                s: known.s,
                d: known.d,
                speed: known.speed,
                slows_at: f64::INFINITY,
                slow: known.speed,
                cruise: known.speed,
                acceleration: 3.0,
                deceleration: 4.0,
                half_length: known.half_length,
                half_width: known.half_width,
            };
        }
    }

    /// Value of moving to `lane` after `delay` at `wanted` speed: the reward's terms over the horizon, with a collision
    /// that weighs the more the sooner it comes.
    fn imagine(&self, world: &World, lane: usize, delay: f64, wanted: f64) -> f64 {
        let (road, ego) = (world.road(), world.ego());
        let weights = &world.scene().reward;
        let top = weights.top_speed_kmh / 3.6;
        let (mut at, mut speed) = (ego.at, ego.speed_mps);
        let (half_length, half_width) = (ego.length_m / 2.0, ego.width_m / 2.0);
        let mut cars = self.cars;
        let mut value = if lane == self.lane {
            0.0
        } else {
            -weights.change
        };
        let mut discount = 1.0;
        let steps = (HORIZON_S / STEP_S) as usize;
        for step in 0..steps {
            let time = (step + 1) as f64 * STEP_S;
            speed += (wanted - speed).clamp(-6.0 * STEP_S, 3.0 * STEP_S);
            at.s_m += speed * STEP_S;
            let target = if time > delay { lane } else { self.lane };
            let aside = road.lane_offset_m(target, at.s_m) - at.d_m;
            // A lane change takes time to set in, and a standing car does not move sideways.
            let rate = ASIDE_MPS.min(0.25 * speed) * STEP_S;
            at.d_m += aside.clamp(-rate, rate);
            let near = road.lane_near(at);
            let mut close = false;
            for car in &mut cars[..self.count] {
                let cruise = if car.s >= car.slows_at {
                    car.slow
                } else {
                    car.cruise
                };
                if world.moving() || ego.speed_mps > 0.0 || wanted > 0.0 {
                    car.speed += (cruise - car.speed)
                        .clamp(-car.deceleration * STEP_S, car.acceleration * STEP_S);
                    car.s += car.speed * STEP_S;
                }
                let along = (car.s - at.s_m).abs() - half_length - car.half_length;
                let across = (car.d - at.d_m).abs() - half_width - car.half_width;
                if along < MARGIN_M[0] && across < MARGIN_M[1] {
                    let touching = along < 0.3 && across < 0.1;
                    value -= if touching { 400.0 } else { 40.0 } * (1.0 - 0.8 * time / HORIZON_S);
                    if touching {
                        return value;
                    }
                }
                if along + half_length < weights.far_m && across < 0.0 {
                    close = true;
                }
            }
            let offset = (at.d_m - road.lane_offset_m(near, at.s_m)).abs();
            let mut reward = speed / top - weights.center * offset / 1.75;
            if close {
                reward -= weights.proximity_far;
            }
            value += discount * reward;
            discount *= 0.97;
        }
        value
    }
}
