//! What a simulated driver knows of the other cars: seen, heard of, and since then reckoned on.

use super::control::Cockpit;
use super::speech::{Heard, SECTOR_AZIMUTHS, UtteranceKind};
use super::{AZIMUTHS, EGO_AHEAD_M, EGO_ROAD_M, EGO_SPEED_MPS, Observation, SECTORS};

/// How long a person takes a car to be.
pub(crate) const CAR_LENGTH_M: f32 = 4.6;
/// Most cars that a person keeps in mind; the farthest are forgotten first.
const MOST: usize = 24;
/// A remembered car this near would be seen; if it is not, it is gone.
const PLAIN_M: f32 = 9.0;
/// Control steps without seeing it after which that is concluded.
const PATIENCE: u32 = 6;
/// Cars farther away are of no concern.
const FAR_M: f32 = 200.0;

/// A car in a person's mind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Known {
    /// Identity, or −1 − sector for one only heard of.
    pub id: i32,
    /// Its centre along the road, from the own car's centre; positive ahead.
    pub x_m: f32,
    /// Its lane, counted from the right.
    pub lane: usize,
    /// Speed when last seen or heard of.
    pub speed_mps: f32,
    /// Control steps since it was last seen or heard of.
    pub unseen: u32,
}

/// Returns of one object in a step.
#[derive(Clone, Copy, Debug, Default)]
struct Sighting {
    id: i32,
    nearest_x_m: f32,
    farthest_x_m: f32,
    left_m: f32,
    count: f32,
    speed_mps: f32,
}

/// The cars in a person's mind.
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    cars: [Known; MOST],
    count: usize,
    /// Curvature of the road behind, remembered from driving it.
    curvature_behind: f32,
}

impl Memory {
    pub(crate) fn new() -> Self {
        Self {
            cars: [Known::default(); MOST],
            count: 0,
            curvature_behind: 0.0,
        }
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::new();
    }

    pub(crate) fn cars(&self) -> &[Known] {
        &self.cars[..self.count]
    }

    /// Reckons every known car on by a step, then takes in what is seen: azimuths for which `seen` holds.
    pub(crate) fn update(
        &mut self,
        cockpit: &Cockpit,
        observation: &Observation,
        here: usize,
        seen: impl Fn(usize, i32, f32) -> bool,
        visible_m: &[f32; AZIMUTHS],
    ) {
        let own = observation.ego[1] * EGO_SPEED_MPS;
        for car in &mut self.cars[..self.count] {
            car.x_m += (car.speed_mps - own) * cockpit.step_s;
            car.unseen += 1;
        }
        let curvature = observation.ego[4] * std::f32::consts::PI / EGO_AHEAD_M as f32;
        self.curvature_behind +=
            (curvature - self.curvature_behind) * (own * cockpit.step_s / 20.0).min(1.0);
        let (sin, cos) = (observation.ego[0] * std::f32::consts::PI).sin_cos();
        let road_offset = observation.ego[3] * EGO_ROAD_M;
        let mut sightings = [Sighting::default(); AZIMUTHS];
        let mut count = 0;
        for azimuth in 0..AZIMUTHS {
            let (object, range_m) = (observation.object[azimuth], observation.nearest_m(azimuth));
            if object < 0 || !seen(azimuth, object, range_m) {
                continue;
            }
            let angle = azimuth as f32 * std::f32::consts::TAU / AZIMUTHS as f32;
            let (ahead, left) = (range_m * angle.cos(), range_m * angle.sin());
            // Into the road's frame: turned by the heading error, straightened by the road's curvature.
            let x = ahead * cos - left * sin;
            let bend = if x > 0.0 {
                curvature
            } else {
                self.curvature_behind
            };
            let y = road_offset + ahead * sin + left * cos - 0.5 * bend * x * x;
            let place = (0..count)
                .find(|&index| sightings[index].id == object)
                .unwrap_or(count);
            let sighting = &mut sightings[place];
            if place == count {
                count += 1;
                *sighting = Sighting {
                    id: object,
                    nearest_x_m: x,
                    farthest_x_m: x,
                    left_m: 0.0,
                    count: 0.0,
                    speed_mps: 0.0,
                };
            }
            sighting.nearest_x_m = sighting.nearest_x_m.min(x);
            sighting.farthest_x_m = sighting.farthest_x_m.max(x);
            sighting.left_m += y;
            sighting.count += 1.0;
            sighting.speed_mps = observation.speed_mps[azimuth];
        }
        for sighting in &sightings[..count] {
            let y = sighting.left_m / sighting.count;
            let from_right = y / cockpit.lane_m + cockpit.lanes as f32 / 2.0;
            let lane = from_right.floor().clamp(0.0, cockpit.lanes as f32 - 1.0) as usize;
            self.see(sighting, lane);
        }
        // What would be in plain sight and is not, is not there.
        let mut index = 0;
        while index < self.count {
            let car = self.cars[index];
            let aside = (car.lane as f32 - here as f32) * cockpit.lane_m;
            let range = car.x_m.hypot(aside);
            let turn = aside.atan2(car.x_m) / std::f32::consts::TAU * AZIMUTHS as f32;
            let azimuth = (turn.round() as i32).rem_euclid(AZIMUTHS as i32) as usize;
            let plain = range < PLAIN_M.min(visible_m[azimuth]) && car.unseen > PATIENCE;
            if plain || car.x_m.abs() > FAR_M {
                self.forget(index);
            } else {
                index += 1;
            }
        }
    }

    fn see(&mut self, sighting: &Sighting, lane: usize) {
        // All returns come from within the car: that bounds its centre.
        let half = CAR_LENGTH_M / 2.0;
        let (low, high) = (sighting.farthest_x_m - half, sighting.nearest_x_m + half);
        let known = self.cars[..self.count]
            .iter()
            .position(|car| car.id == sighting.id);
        let expected = match known {
            Some(index) => self.cars[index].x_m,
            None if sighting.nearest_x_m > 0.0 => high,
            None if sighting.farthest_x_m < 0.0 => low,
            None => (low + high) / 2.0,
        };
        let x_m = if low <= high {
            expected.clamp(low, high)
        } else {
            (low + high) / 2.0
        };
        let car = Known {
            id: sighting.id,
            x_m,
            lane,
            speed_mps: sighting.speed_mps,
            unseen: 0,
        };
        match known {
            Some(index) => self.cars[index] = car,
            None => self.remember(car),
        }
        // This may be the car that was spoken of.
        let near = |other: &Known| {
            other.id < 0 && other.lane == lane && (other.x_m - x_m).abs() < 2.0 * CAR_LENGTH_M
        };
        while let Some(index) = self.cars[..self.count].iter().position(near) {
            self.forget(index);
        }
    }

    /// Takes in an utterance: its kind, and roughly where the car is.
    pub(crate) fn hear(
        &mut self,
        sector: usize,
        heard: &Heard,
        here: usize,
        lane_m: f32,
        lanes: usize,
    ) {
        if sector >= SECTORS {
            return;
        }
        let (first, last) = SECTOR_AZIMUTHS[sector];
        let side: i32 = match sector {
            1 | 2 => 1,
            4 | 5 => -1,
            _ => 0,
        };
        let lane = (here as i32 + side).clamp(0, lanes as i32 - 1) as usize;
        let of_sector = |car: &Known| {
            let aside = (car.lane as f32 - here as f32) * lane_m;
            let turn = aside.atan2(car.x_m) / std::f32::consts::TAU * AZIMUTHS as f32;
            let azimuth = (turn.round() as i32).rem_euclid(AZIMUTHS as i32) as usize;
            (first..=last).contains(&azimuth)
        };
        if heard.kind == UtteranceKind::Nothing {
            while let Some(index) = self.cars[..self.count].iter().position(of_sector) {
                self.forget(index);
            }
            return;
        }
        let direction = if matches!(sector, 2..=4) { -1.0 } else { 1.0 };
        let aside = side as f32 * lane_m;
        let reach = (heard.range_m.powi(2) - aside * aside).max(0.0).sqrt();
        let x_m = direction * (reach + CAR_LENGTH_M / 2.0);
        let id = -1 - sector as i32;
        let car = Known {
            id,
            x_m,
            lane,
            speed_mps: heard.speed_mps,
            unseen: 0,
        };
        // The car may be known already, by sight or from an earlier utterance.
        let same = |known: &Known| {
            known.id == id || known.lane == lane && (known.x_m - x_m).abs() < 2.0 * CAR_LENGTH_M
        };
        match self.cars[..self.count].iter().position(same) {
            Some(index) if self.cars[index].unseen > 0 => {
                let id = self.cars[index].id;
                self.cars[index] = Known { id, ..car };
            }
            Some(_) => {}
            None => self.remember(car),
        }
    }

    fn remember(&mut self, car: Known) {
        if self.count < MOST {
            self.cars[self.count] = car;
            self.count += 1;
            return;
        }
        let mut farthest = 0;
        for (index, known) in self.cars.iter().enumerate() {
            if known.x_m.abs() > self.cars[farthest].x_m.abs() {
                farthest = index;
            }
        }
        self.cars[farthest] = car;
    }

    fn forget(&mut self, index: usize) {
        self.count -= 1;
        self.cars[index] = self.cars[self.count];
    }
}
