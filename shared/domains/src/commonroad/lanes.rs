//! Lanelets as geometry: centre lines, which lanelet lies under a point, and the chains that make lanes.

use super::scenario::{Lanelet, Scenario, inside, wrap};
use crate::highway::road::LaneEdges;

/// A lanelet belongs to the carriageway while it runs within this angle of the reference line.
const PARALLEL_RAD: f64 = std::f64::consts::FRAC_PI_4 * 1.2;

/// Lanelets prepared for questions about places; indices are those of [`Scenario::lanelets`].
#[derive(Clone, Debug)]
pub struct LaneletMap {
    centers: Vec<Vec<[f64; 2]>>,
    outlines: Vec<Vec<[f64; 2]>>,
    successors: Vec<Vec<usize>>,
    predecessors: Vec<Vec<usize>>,
    neighbours: Vec<Vec<usize>>,
}

impl LaneletMap {
    /// Prepares all lanelets of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let indices = |ids: &[i64]| -> Vec<usize> {
            ids.iter()
                .filter_map(|id| scenario.lanelet_index(*id))
                .collect()
        };
        let lanelets = &scenario.lanelets;
        let mut map = Self {
            centers: lanelets.iter().map(center_line).collect(),
            outlines: lanelets
                .iter()
                .map(|lanelet| {
                    lanelet
                        .left
                        .iter()
                        .chain(lanelet.right.iter().rev())
                        .copied()
                        .collect()
                })
                .collect(),
            successors: lanelets.iter().map(|l| indices(&l.successors)).collect(),
            predecessors: vec![Vec::new(); lanelets.len()],
            neighbours: lanelets
                .iter()
                .map(|l| {
                    [l.left_neighbour, l.right_neighbour]
                        .into_iter()
                        .flatten()
                        .filter(|adjacent| adjacent.same_direction)
                        .filter_map(|adjacent| scenario.lanelet_index(adjacent.id))
                        .collect()
                })
                .collect(),
        };
        // A link counts whichever of its two ends states it.
        for (index, lanelet) in lanelets.iter().enumerate() {
            for before in indices(&lanelet.predecessors) {
                if !map.successors[before].contains(&index) {
                    map.successors[before].push(index);
                }
            }
        }
        for index in 0..lanelets.len() {
            for next in map.successors[index].clone() {
                map.predecessors[next].push(index);
            }
        }
        map
    }

    /// The centre line of a lanelet, at least two points.
    pub fn center(&self, index: usize) -> &[[f64; 2]] {
        &self.centers[index]
    }

    /// The lanelets that this one leads into.
    pub fn successors(&self, index: usize) -> &[usize] {
        &self.successors[index]
    }

    /// Whether a point lies on a lanelet.
    pub fn contains(&self, index: usize, point: [f64; 2]) -> bool {
        inside(&self.outlines[index], point)
    }

    /// Whether a point lies on a lanelet or within `within_m` of its outline.
    pub fn near(&self, index: usize, point: [f64; 2], within_m: f64) -> bool {
        let outline = &self.outlines[index];
        let sides = outline.iter().zip(outline.iter().cycle().skip(1));
        self.contains(index, point)
            || sides
                .into_iter()
                .any(|(a, b)| distance_to(point, *a, *b) <= within_m)
    }

    /// Distance of a point from a lanelet's centre line, left positive, and the line's direction there, in m and rad.
    pub fn offset(&self, index: usize, point: [f64; 2]) -> (f64, f64) {
        let mut best = (f64::INFINITY, 0.0, 0.0);
        for pair in self.centers[index].windows(2) {
            let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
            let from = [point[0] - pair[0][0], point[1] - pair[0][1]];
            let square = along[0] * along[0] + along[1] * along[1];
            let t = ((from[0] * along[0] + from[1] * along[1]) / square).clamp(0.0, 1.0);
            let away = (from[0] - t * along[0]).hypot(from[1] - t * along[1]);
            if away < best.0 {
                let side = along[0] * from[1] - along[1] * from[0];
                best = (away, away.copysign(side), along[1].atan2(along[0]));
            }
        }
        (best.1, best.2)
    }

    /// The lanelet under a car: of those that contain the point, the one most aligned with the heading; where none
    /// does, the one whose centre line is nearest.
    pub fn under(&self, point: [f64; 2], heading_rad: f64) -> usize {
        let mut best = (f64::INFINITY, 0);
        for index in 0..self.centers.len() {
            let (away, direction) = self.offset(index, point);
            let turn = wrap(heading_rad - direction).abs();
            let score = if self.contains(index, point) {
                turn
            } else {
                10.0 + away.abs() + turn
            };
            if score < best.0 {
                best = (score, index);
            }
        }
        best.1
    }

    /// Direction of a lanelet's first or last metres.
    fn direction(&self, index: usize, at_end: bool) -> f64 {
        let line = &self.centers[index];
        let pair = if at_end {
            [line[line.len() - 2], line[line.len() - 1]]
        } else {
            [line[0], line[1]]
        };
        (pair[1][1] - pair[0][1]).atan2(pair[1][0] - pair[0][0])
    }

    /// How much a car turns between two successive lanelets: over all of the second, so that a fork's branches differ
    /// even where they start alike.
    fn bend(&self, from: usize, to: usize) -> f64 {
        let start = self.direction(from, true);
        wrap(self.direction(to, false) - start).abs() + wrap(self.direction(to, true) - start).abs()
    }

    /// The straightest way on from a lanelet.
    fn next(&self, index: usize) -> Option<usize> {
        self.successors[index].iter().copied().min_by(|a, b| {
            self.bend(index, *a)
                .total_cmp(&self.bend(index, *b))
                .then(a.cmp(b))
        })
    }

    /// The straightest way back from a lanelet.
    fn before(&self, index: usize) -> Option<usize> {
        self.predecessors[index].iter().copied().min_by(|a, b| {
            self.bend(*a, index)
                .total_cmp(&self.bend(*b, index))
                .then(a.cmp(b))
        })
    }

    /// The lanelets from the map's edge through `start` to the map's edge: the straightest way, except that it leads
    /// through one of `goals` where that can be reached without changing lanes. No lanelet comes twice.
    pub fn route(&self, start: usize, goals: &[usize]) -> Vec<usize> {
        let mut route = self.path(start, goals);
        let mut used = vec![false; self.centers.len()];
        route.iter().for_each(|index| used[*index] = true);
        while let Some(next) = route
            .last()
            .and_then(|last| self.next(*last))
            .filter(|next| !used[*next])
        {
            used[next] = true;
            route.push(next);
        }
        let mut back = Vec::new();
        let mut at = start;
        while let Some(before) = self.before(at).filter(|before| !used[*before]) {
            used[before] = true;
            back.push(before);
            at = before;
        }
        back.reverse();
        back.extend(route);
        back
    }

    /// The shortest way by successors from `start` to one of `goals`; `start` alone where there is none.
    fn path(&self, start: usize, goals: &[usize]) -> Vec<usize> {
        let mut came_from: Vec<Option<usize>> = vec![None; self.centers.len()];
        let mut queue = std::collections::VecDeque::from([start]);
        let mut seen = vec![false; self.centers.len()];
        seen[start] = true;
        while let Some(index) = queue.pop_front() {
            if goals.contains(&index) {
                let mut path = vec![index];
                let mut at = index;
                while let Some(previous) = came_from[at] {
                    path.push(previous);
                    at = previous;
                }
                path.reverse();
                return path;
            }
            for &next in &self.successors[index] {
                if !seen[next] {
                    seen[next] = true;
                    came_from[next] = Some(index);
                    queue.push_back(next);
                }
            }
        }
        vec![start]
    }

    /// One line through the centres of `route`.
    pub fn line(&self, route: &[usize]) -> Vec<[f64; 2]> {
        route
            .iter()
            .flat_map(|index| self.centers[*index].iter().copied())
            .collect()
    }

    /// The lanelets of the carriageway around `route`: those that same-direction neighbours, successors and
    /// predecessors lead to, while they run roughly along it.
    pub fn carriageway(&self, route: &[usize], heading_at: impl Fn([f64; 2]) -> f64) -> Vec<usize> {
        let parallel = |index: usize| {
            self.centers[index].windows(2).all(|pair| {
                let direction = (pair[1][1] - pair[0][1]).atan2(pair[1][0] - pair[0][0]);
                let middle = [
                    (pair[0][0] + pair[1][0]) / 2.0,
                    (pair[0][1] + pair[1][1]) / 2.0,
                ];
                // Lanelet points lie as close as 0.3 m with an error of centimetres: a short piece says nothing.
                let length = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
                length < 1.0 || wrap(direction - heading_at(middle)).abs() < PARALLEL_RAD
            })
        };
        let mut seen = vec![false; self.centers.len()];
        route.iter().for_each(|index| seen[*index] = true);
        let mut queue: Vec<usize> = route.to_vec();
        let mut found = Vec::new();
        while let Some(index) = queue.pop() {
            found.push(index);
            let around = [
                &self.successors[index],
                &self.predecessors[index],
                &self.neighbours[index],
            ];
            for &next in around.into_iter().flatten() {
                if !seen[next] {
                    seen[next] = true;
                    if parallel(next) {
                        queue.push(next);
                    }
                }
            }
        }
        found.sort_unstable();
        found
    }

    /// Chains of successors that cover `members`, each lanelet once. A lanelet is continued by the straightest
    /// successor that continues nothing straighter; chains are ordered by their first lanelet.
    pub fn chains(&self, members: &[usize]) -> Vec<Vec<usize>> {
        let is_member = |index: &usize| members.binary_search(index).is_ok();
        let mut links: Vec<(usize, usize)> = members
            .iter()
            .flat_map(|from| {
                self.successors[*from]
                    .iter()
                    .filter(|to| is_member(to))
                    .map(|to| (*from, *to))
            })
            .collect();
        links.sort_by(|a, b| {
            self.bend(a.0, a.1)
                .total_cmp(&self.bend(b.0, b.1))
                .then(a.cmp(b))
        });
        let mut next: Vec<Option<usize>> = vec![None; self.centers.len()];
        let mut continued: Vec<bool> = vec![false; self.centers.len()];
        for (from, to) in links {
            if next[from].is_none() && !continued[to] {
                next[from] = Some(to);
                continued[to] = true;
            }
        }
        let mut used = vec![false; self.centers.len()];
        let mut chains = Vec::new();
        // First the chains that begin somewhere, then what is left: rings, cut open at their first lanelet.
        for rings in [false, true] {
            for &first in members {
                if used[first] || (continued[first] && !rings) {
                    continue;
                }
                let mut chain = Vec::new();
                let mut at = Some(first);
                while let Some(index) = at.filter(|index| !used[*index]) {
                    used[index] = true;
                    chain.push(index);
                    at = next[index];
                }
                chains.push(chain);
            }
        }
        chains
    }
}

/// The edges of a chain of lanelets as one lane.
pub(crate) fn edges(scenario: &Scenario, chain: &[usize]) -> LaneEdges {
    let collect = |side: fn(&Lanelet) -> &[[f64; 2]]| {
        chain
            .iter()
            .flat_map(|index| side(&scenario.lanelets[*index]).iter().copied())
            .collect()
    };
    LaneEdges {
        left: collect(|lanelet| &lanelet.left),
        right: collect(|lanelet| &lanelet.right),
    }
}

/// Halfway between the bounds: point by point where both have as many, else at equal fractions of their lengths.
fn center_line(lanelet: &Lanelet) -> Vec<[f64; 2]> {
    let (left, right) = (&lanelet.left, &lanelet.right);
    let mean = |a: [f64; 2], b: [f64; 2]| [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
    let mut line: Vec<[f64; 2]> = if left.len() == right.len() {
        left.iter().zip(right).map(|(a, b)| mean(*a, *b)).collect()
    } else {
        let count = left.len().max(right.len());
        let at = |line: &[[f64; 2]], index: usize| along(line, index as f64 / (count - 1) as f64);
        (0..count)
            .map(|index| mean(at(left, index), at(right, index)))
            .collect()
    };
    line.dedup();
    if line.len() < 2 {
        // Bounds that run against each other share one middle: the left bound is then the better line.
        return left.clone();
    }
    line
}

/// Distance of a point from the line between two others.
fn distance_to(point: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (along, from) = (
        [b[0] - a[0], b[1] - a[1]],
        [point[0] - a[0], point[1] - a[1]],
    );
    let square = along[0] * along[0] + along[1] * along[1];
    let t = match square > 0.0 {
        true => ((from[0] * along[0] + from[1] * along[1]) / square).clamp(0.0, 1.0),
        false => 0.0,
    };
    (from[0] - t * along[0]).hypot(from[1] - t * along[1])
}

/// The point at a fraction of a polyline's length.
fn along(line: &[[f64; 2]], fraction: f64) -> [f64; 2] {
    let step = |pair: &[[f64; 2]]| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
    let mut left = fraction * line.windows(2).map(step).sum::<f64>();
    for pair in line.windows(2) {
        let length = step(pair);
        if left <= length {
            let t = left / length;
            return [
                pair[0][0] + t * (pair[1][0] - pair[0][0]),
                pair[0][1] + t * (pair[1][1] - pair[0][1]),
            ];
        }
        left -= length;
    }
    line[line.len() - 1]
}
