//! What `mirror profile` writes, read by other means than its own: the trace as Perfetto takes it, the histograms by
//! HdrHistogram's reader.

use hdrhistogram::Histogram;
use hdrhistogram::serialization::Deserializer;
use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// A slice of the trace, on the monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct Slice {
    pub from: u64,
    pub to: u64,
}

pub struct Trace {
    pub events: Vec<Value>,
    pub start: u64,
    pids: BTreeMap<String, u64>,
}

impl Trace {
    pub fn read(directory: &Path) -> Self {
        let trace = json(&directory.join("trace.json"));
        let events = trace["traceEvents"].as_array().unwrap().clone();
        let pids = events
            .iter()
            .filter(|event| event["name"] == "process_name")
            .map(|event| {
                let name = event["args"]["name"].as_str().unwrap().to_owned();
                (name, event["pid"].as_u64().unwrap())
            })
            .collect();
        let start = trace["otherData"]["start_monotonic_ns"].as_u64().unwrap();
        Self {
            events,
            start,
            pids,
        }
    }

    pub fn ns(&self, us: &Value) -> u64 {
        self.start + (us.as_f64().unwrap() * 1000.0).round() as u64
    }

    /// When each message of a topic was sent and used. An arrow starts a nanosecond before the sending, to lie in its slice.
    pub fn arrows(&self, topic: &str) -> Vec<(u64, u64)> {
        let ends = |phase: &str| -> BTreeMap<u64, u64> {
            let of = |event: &&Value| event["ph"] == phase && event["name"] == topic;
            let end = |event: &Value| (event["id"].as_u64().unwrap(), self.ns(&event["ts"]));
            self.events.iter().filter(of).map(end).collect()
        };
        let used = ends("f");
        let from = ends("s").into_iter();
        from.map(|(id, sent)| (sent + 1, used[&id])).collect()
    }

    pub fn slices(&self, process: &str, name: &str) -> Vec<Slice> {
        let pid = self.pids[process];
        let is = |event: &&Value| event["ph"] == "X" && event["pid"] == pid;
        self.events
            .iter()
            .filter(is)
            .filter(|event| event["name"].as_str().unwrap().starts_with(name))
            .map(|event| {
                let from = self.ns(&event["ts"]);
                let length = (event["dur"].as_f64().unwrap() * 1000.0).round() as u64;
                Slice {
                    from,
                    to: from + length,
                }
            })
            .collect()
    }
}

pub fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// The interval log decodes with HdrHistogram's own reader, one histogram per figure, nothing left out.
pub fn check_histograms(out: &Path, profile: &Value) {
    let log = std::fs::read(out.join("profile.hlog")).unwrap();
    let mut counts = BTreeMap::new();
    for entry in IntervalLogIterator::new(&log) {
        if let LogEntry::Interval(interval) = entry.unwrap() {
            let bytes = base64(interval.encoded_histogram());
            let histogram: Histogram<u64> =
                Deserializer::new().deserialize(&mut &bytes[..]).unwrap();
            let tag = interval.tag().unwrap().as_str().to_owned();
            counts.insert(tag, (histogram.len(), histogram.max()));
        }
    }
    let metrics = profile["metrics"].as_object().unwrap();
    assert_eq!(counts.len(), metrics.len());
    for (name, metric) in metrics {
        let tag = name.replace('→', "to").replace(' ', "_");
        let (count, max) = counts[&tag];
        assert_eq!(metric["count"], count, "{name}");
        let exact = metric["max"].as_u64().unwrap();
        assert!(
            max >= exact && max as f64 <= 1.002 * exact as f64 + 1.0,
            "{name}: {max} {exact}"
        );
    }
}

/// Base64 with padding, as an interval log carries it.
fn base64(text: &str) -> Vec<u8> {
    let (mut bytes, mut bits, mut held) = (Vec::new(), 0u32, 0);
    for letter in text.bytes().filter(|letter| *letter != b'=') {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            other => panic!("{other} is no base64"),
        };
        bits = bits << 6 | u32::from(value);
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    bytes
}

/// What Perfetto asks of a trace: slices of a track do not overlap, and every arrow begins and ends in a slice.
pub fn check_trace(trace: &Trace) {
    let mut slices: BTreeMap<u64, Vec<Slice>> = BTreeMap::new();
    for process in trace.pids.keys() {
        let mut of_process = trace.slices(process, "");
        of_process.sort_by_key(|slice| slice.from);
        for pair in of_process.windows(2) {
            assert!(pair[0].to <= pair[1].from, "{process}: {pair:?}");
        }
        slices.insert(trace.pids[process], of_process);
    }
    let mut ends: BTreeMap<u64, Vec<(String, u64)>> = BTreeMap::new();
    for event in &trace.events {
        let phase = event["ph"].as_str().unwrap();
        assert!(["M", "X", "s", "f"].contains(&phase), "{event}");
        if phase == "s" || phase == "f" {
            let at = trace.ns(&event["ts"]);
            let inside = slices[&event["pid"].as_u64().unwrap()]
                .iter()
                .any(|slice| slice.from <= at && at < slice.to);
            assert!(inside, "{event} is in no slice");
            let id = event["id"].as_u64().unwrap();
            ends.entry(id).or_default().push((phase.to_owned(), at));
        }
    }
    assert!(ends.len() > 100, "{} arrows", ends.len());
    for (id, ends) in ends {
        let [(start, from), (finish, to)] = &ends[..] else {
            panic!("arrow {id}: {ends:?}");
        };
        assert_eq!((start.as_str(), finish.as_str()), ("s", "f"));
        assert!(from <= to, "arrow {id} goes back in time");
    }
}
