//! What a file holds that has no part in a drive: counted and named, so that nobody takes it for driven by.

use super::scenario::Scenario;
use super::xml::{Element, children};
use std::collections::BTreeMap;

/// Elements that are passed over: their names, and what people call one of them and several.
const PASSED_OVER: [(&str, &str, &str); 7] = [
    ("trafficLight", "traffic light", "traffic lights"),
    ("trafficSign", "traffic sign", "traffic signs"),
    ("stopLine", "stop line", "stop lines"),
    ("intersection", "intersection", "intersections"),
    ("environmentObstacle", "building", "buildings"),
    ("phantomObstacle", "phantom obstacle", "phantom obstacles"),
    ("signalSeries", "car's light signals", "cars' light signals"),
];

/// What has been left out so far.
#[derive(Default)]
pub(super) struct LeftOut {
    counts: BTreeMap<&'static str, usize>,
    /// Links of lanelets to themselves, in words.
    own_links: Vec<String>,
    /// States that stand twice.
    pub repeated_states: usize,
    /// Links to lanelets that the file lacks.
    pub loose_links: usize,
}

impl LeftOut {
    /// Counts an element that may be passed over; whether it may.
    pub fn count(&mut self, name: &str) -> bool {
        let known = PASSED_OVER.iter().find(|(known, ..)| *known == name);
        if let Some((known, ..)) = known {
            *self.counts.entry(known).or_default() += 1;
        }
        known.is_some()
    }

    /// Counts those children of an element that are passed over.
    pub fn count_in(&mut self, element: Element, names: &[&str]) {
        for name in names {
            children(element, name).for_each(|_| {
                self.count(name);
            });
        }
    }

    /// Notes that a lanelet is linked to itself.
    pub fn own_link(&mut self, lanelet: i64, link: &str, line: usize) {
        self.own_links
            .push(format!("lanelet {lanelet} as its own {link} (line {line})"));
    }

    /// All of it, in words.
    pub fn words(self, read: &Scenario) -> Vec<String> {
        let counted = PASSED_OVER.iter().filter_map(|(name, one, several)| {
            let count = *self.counts.get(name)?;
            Some(number_of(count, one, several))
        });
        let mut words: Vec<String> = counted.collect();
        if self.loose_links > 0 {
            let links = number_of(self.loose_links, "link", "links");
            words.push(format!("{links} to lanelets that the file lacks"));
        }
        words.extend(self.own_links);
        words.extend(read.bad_lanelets.iter().map(|bad| bad.words()));
        if self.repeated_states > 0 {
            let states = number_of(self.repeated_states, "state", "states");
            words.push(format!("{states} said again"));
        }
        words
    }
}

fn number_of(count: usize, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}
