//! Who is near, and what the ego car measures.

use super::{NEIGHBOUR_M, World};
use crate::highway::lidar::Lidar;
use crate::highway::road::wrap_angle;
use crate::highway::traffic::CarState;
use crate::highway::{EGO_AHEAD_M, EGO_LANE_M, EGO_ROAD_M, EGO_SPEED_MPS};

impl World {
    /// Insertion sort: from tick to tick, hardly anything moves.
    pub(super) fn sort(&mut self) {
        let key = |index: u32| {
            let car = &self.cars[index as usize];
            (car.lane, car.at.s_m)
        };
        for end in 1..self.order.len() {
            let moved = self.order[end];
            let moved_key = key(moved);
            let mut place = end;
            while place > 0 && key(self.order[place - 1]) > moved_key {
                self.order[place] = self.order[place - 1];
                place -= 1;
            }
            self.order[place] = moved;
        }
    }

    /// Visits the cars within `reach_m` along the road, by lane.
    pub(super) fn neighbours<'a>(&'a self, reach_m: f64, mut visit: impl FnMut(&'a CarState)) {
        let (low, high) = (self.ego.at.s_m - reach_m, self.ego.at.s_m + reach_m);
        for lane in 0..self.course.road.lanes().len() {
            let start = self.order.partition_point(|&index| {
                let car = &self.cars[index as usize];
                (car.lane, car.at.s_m) < (lane, low)
            });
            for &index in &self.order[start..] {
                let car = &self.cars[index as usize];
                if car.lane != lane || car.at.s_m > high {
                    break;
                }
                if car.present {
                    visit(car);
                }
            }
        }
    }

    /// Fills `self.observation`.
    pub(super) fn sense(&mut self) {
        let mut out = std::mem::take(&mut self.observation);
        Lidar::clear(&mut out);
        let (sin, cos) = self.ego.pose.heading_rad.sin_cos();
        let (x, y) = (self.ego.pose.x_m, self.ego.pose.y_m);
        self.neighbours(NEIGHBOUR_M.max(self.longest_half_m + 45.0), |car| {
            self.lidar.cast(x, y, cos, sin, car, &mut out)
        });
        let (road, ego) = (&self.course.road, &self.ego);
        let lane_heading = road.lane_heading_rad(ego.lane, ego.at.s_m);
        let pi = std::f64::consts::PI;
        out.ego = [
            (wrap_angle(ego.pose.heading_rad - lane_heading) / pi) as f32,
            ego.speed_mps as f32 / EGO_SPEED_MPS,
            (ego.at.d_m - road.lane_offset_m(ego.lane, ego.at.s_m)) as f32 / EGO_LANE_M,
            (ego.at.d_m - road.center_m(ego.at.s_m)) as f32 / EGO_ROAD_M,
            ((road.lane_heading_rad(ego.lane, ego.at.s_m + EGO_AHEAD_M) - lane_heading) / pi)
                as f32,
        ];
        out.moving = self.moving;
        self.observation = out;
    }
}
