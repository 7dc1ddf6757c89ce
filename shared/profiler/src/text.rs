//! A profile as a table for people.

use crate::compare::{Change, ChangeVerdict, Older};
use crate::graph::{EDGES, Edge};
use crate::metrics::{self, Metric, compute_of, hop_of, wait_of};
use crate::result::{Measured, Profile, Trace};
use crate::units::{count, time_us};
use messages::PROCESSES;
use runtime::ClockMode;
use std::fmt::Write;

/// Parts of the critical path below this share are summed up.
const LEAST_SHARE: f64 = 0.005;

/// The whole profile.
pub fn text(profile: &Profile) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "\nMeasured: {}", conditions(&profile.measured));
    write_counts(&mut out, profile);
    write_processes(&mut out, profile);
    write_waits(&mut out, profile);
    write_latencies(&mut out, profile);
    write_path(&mut out, profile);
    if let Some(trace) = &profile.slowest {
        write_trace(&mut out, "Slowest", trace);
    }
    write_own(&mut out, profile);
    out
}

/// What was measured under which conditions, in words.
pub fn conditions(measured: &Measured) -> String {
    let about = &measured.about;
    let or = |text: &Option<String>| text.clone().unwrap_or_else(|| "?".to_owned());
    let mut out = format!(
        "{} ({}), {:.1} s, until {}\n  scene {} · driver {} · human {} · planner {}",
        measured.instance,
        if measured.attached {
            "it ran already"
        } else {
            "started for this"
        },
        measured.seconds,
        measured.ended,
        or(&about.scene),
        or(&about.driver),
        or(&about.human),
        or(&about.planner),
    );
    let clock = match about.clock {
        Some(ClockMode::Lockstep) => "lockstep",
        Some(ClockMode::RealTime) => "real time",
        None => "?",
    };
    let _ = write!(
        out,
        "\n  clock {clock} · waiting by {} · recorder {}",
        measured.waiting,
        match &about.record {
            Some(file) => format!("writes {file}"),
            None => "on, writes no file".to_owned(),
        }
    );
    let _ = write!(
        out,
        "\n  {} cores · load average {:.2} before, {:.2} after · others kept {:.2} cores busy",
        measured.cores, measured.load_before[0], measured.load_after[0], measured.others_busy_cores
    );
    if measured.others_busy_cores > 0.1 * measured.cores as f64 {
        out += "\n  THE MACHINE WAS BUSY WITH OTHER WORK: every time below is longer for it";
    }
    out
}

fn write_counts(out: &mut String, profile: &Profile) {
    let counts = &profile.counts;
    let _ = writeln!(
        out,
        "  {} of {}, {} · missed deadlines {} · {}",
        count(counts.steps, "step"),
        count(counts.episodes, "episode"),
        count(counts.messages, "message"),
        counts.missed_deadlines,
        match counts.lost_messages.values().sum::<u64>() {
            0 => "no message lost".to_owned(),
            lost => format!("LOST {}", count(lost, "message")),
        }
    );
    if counts.futures_per_plan > 0.0 {
        let _ = writeln!(
            out,
            "  a plan rests on {:.0} futures and imagines {:.0} lives in them, on average",
            counts.futures_per_plan, counts.samples_per_plan
        );
    }
    for (topic, lost) in counts.lost_messages.iter().filter(|(_, lost)| **lost > 0) {
        let _ = writeln!(out, "  LOST {lost} on {topic}");
    }
    for (topic, lost) in counts.profiler_lost.iter().filter(|(_, lost)| **lost > 0) {
        let _ = writeln!(
            out,
            "  the profiler itself missed {lost} on {topic}: not counted below"
        );
    }
    if counts.incomplete_steps > 0 {
        let _ = writeln!(
            out,
            "  {} steps were not seen whole",
            counts.incomplete_steps
        );
    }
}

/// Five percentiles.
fn columns(metric: &Metric) -> String {
    let Metric {
        p50,
        p90,
        p99,
        p999,
        max,
        ..
    } = metric;
    [p50, p90, p99, p999, max]
        .map(|ns| format!("{:>10}", time_us(*ns as f64 / 1000.0)))
        .concat()
}

const COLUMNS: &str = "       p50       p90       p99     p99.9       max";

fn write_processes(out: &mut String, profile: &Profile) {
    let _ = writeln!(
        out,
        "\nComputes, per step      {COLUMNS}     count\n  (exact: from each message's header)"
    );
    let mut line = |name: &str, metric: &str| {
        if let Some(metric) = profile.metrics.get(metric) {
            let count = metric.count;
            let _ = writeln!(out, "  {name:<22}{}{count:>10}", columns(metric));
        }
    };
    for (process, name) in PROCESSES.iter().enumerate() {
        line(name, &compute_of(process));
        if *name == "human" {
            line("human, answers/plan", metrics::ANSWERS);
        }
        if *name == "planner" {
            line("planner awaits answers", metrics::AWAITED);
        }
    }
    let _ = writeln!(
        out,
        "\nTakes                 CPU, % of a core   could run, no core   switches/s (waits, ousted)   threads   RSS MiB   PSS MiB   missed   lost"
    );
    for name in PROCESSES.iter().chain(&["launcher"]) {
        let Some(process) = profile.processes.get(*name) else {
            continue;
        };
        let percent = |share: Option<f64>| match share {
            Some(share) => format!("{:.1} %", 100.0 * share),
            None => "?".to_owned(),
        };
        let mib = |kib: Option<u64>| match kib {
            Some(kib) => format!("{:.1}", kib as f64 / 1024.0),
            None => "?".to_owned(),
        };
        let switches = match process.switches_per_s {
            Some([waited, ousted]) => format!("{waited:.0}, {ousted:.0}"),
            None => "?".to_owned(),
        };
        let (missed, lost) = match &process.reported {
            Some(reported) => (
                reported.missed_deadlines.to_string(),
                reported.lost.values().sum::<u64>().to_string(),
            ),
            None => ("–".to_owned(), "–".to_owned()),
        };
        let threads = process
            .threads
            .map_or("?".to_owned(), |threads| threads.to_string());
        let _ = writeln!(
            out,
            "  {name:<20}{:>18}{:>21}{switches:>29}{threads:>10}{:>10}{:>10}{missed:>9}{lost:>7}",
            percent(process.cpu_share),
            percent(process.queued_share),
            mib(process.rss_kib),
            mib(process.pss_kib),
        );
    }
}

fn write_waits(out: &mut String, profile: &Profile) {
    let _ = writeln!(
        out,
        "\nWaits, from its sending until its receiver began the step that used it\n  \
         (inferred as sent − computed − input's sending: exact where a step computes in one piece, else a lower limit)\n  \
         every message           {COLUMNS}     count"
    );
    let write = |out: &mut String, name: String, metric: &Metric| {
        let _ = write!(out, "  {name:<24}{}{:>10}", columns(metric), metric.count);
        let _ = match metric.clamped {
            0 => writeln!(out),
            clamped => writeln!(out, "   {clamped} at least 0"),
        };
    };
    for (place, edge) in named_edges() {
        if let Some(metric) = profile.metrics.get(&wait_of(place)) {
            write(out, edge.name(), metric);
        }
    }
    if let Some(metric) = profile.metrics.get(metrics::QUESTION) {
        write(out, "human/imagine → human".to_owned(), metric);
    }
    let _ = writeln!(
        out,
        "  of these, the step's last input: what it costs to be woken and to get a core"
    );
    for (place, edge) in named_edges() {
        if let Some(metric) = profile.metrics.get(&hop_of(place)) {
            write(out, edge.name(), metric);
        }
    }
}

/// Edges whose names no earlier one has: frames and observations go the same ways, and a set has one of them.
fn named_edges() -> impl Iterator<Item = (usize, &'static Edge)> {
    let is_first = |(place, edge): &(usize, &Edge)| {
        let mut earlier = EDGES[..*place].iter();
        !earlier.any(|other| other.name() == edge.name())
    };
    EDGES.iter().enumerate().filter(is_first)
}

fn write_latencies(out: &mut String, profile: &Profile) {
    let _ = writeln!(out, "\nLatency                   {COLUMNS}     count");
    for name in [
        metrics::TICK,
        metrics::TO_DECISION,
        metrics::TO_DISPLAY,
        metrics::TO_SHOWN,
    ] {
        if let Some(metric) = profile.metrics.get(name) {
            let _ = writeln!(out, "  {name:<24}{}{:>10}", columns(metric), metric.count);
        }
    }
}

fn latency_name(profile: &Profile) -> &'static str {
    match profile.measured.about.clock {
        Some(ClockMode::RealTime) => "the way from sensing to decision",
        _ => "a tick",
    }
}

fn write_path(out: &mut String, profile: &Profile) {
    let total: f64 = profile.path.iter().map(|part| part.mean_ns).sum();
    if total <= 0.0 {
        return;
    }
    let _ = writeln!(
        out,
        "\nWhere {} goes, along the critical path: mean {}",
        latency_name(profile),
        time_us(total / 1000.0)
    );
    let mut rest = 0.0;
    for part in &profile.path {
        if part.share < LEAST_SHARE {
            rest += part.mean_ns;
            continue;
        }
        let _ = writeln!(
            out,
            "  {:>9} {:>5.1} %  {:<9} {} (on the path of {} steps)",
            time_us(part.mean_ns / 1000.0),
            100.0 * part.share,
            part.process,
            part.what,
            part.steps
        );
    }
    if rest > 0.0 {
        let _ = writeln!(
            out,
            "  {:>9} {:>5.1} %  everything else",
            time_us(rest / 1000.0),
            100.0 * rest / total
        );
    }
}

fn write_trace(out: &mut String, which: &str, trace: &Trace) {
    let _ = writeln!(
        out,
        "\n{which} step: episode {} step {}, {}",
        trace.episode,
        trace.step,
        time_us(trace.latency_ns as f64 / 1000.0)
    );
    // A plan's dozens of questions would hide the rest: equal stretches of one process in a row of them are summed up.
    let mut parts: Vec<(String, String, i64, i64, usize)> = Vec::new();
    for span in &trace.path {
        let ns = span.to_ns - span.from_ns;
        let near = parts.len().saturating_sub(2);
        let same = parts[near..]
            .iter_mut()
            .find(|(process, what, ..)| *process == span.process && *what == span.what);
        match same {
            Some((.., sum, count)) => {
                *sum += ns;
                *count += 1;
            }
            None => parts.push((span.process.clone(), span.what.clone(), span.from_ns, ns, 1)),
        }
    }
    for (process, what, from_ns, ns, count) in parts {
        let times = if count > 1 {
            format!(" ({count} times)")
        } else {
            String::new()
        };
        let _ = writeln!(
            out,
            "  at {:>9} for {:>9}  {process:<9} {what}{times}",
            time_us(from_ns as f64 / 1000.0),
            time_us(ns as f64 / 1000.0)
        );
    }
}

fn write_own(out: &mut String, profile: &Profile) {
    let own = &profile.own;
    let _ = writeln!(
        out,
        "\nThe profiler itself: {:.3} s of processor time, {:.2} % of a core; {:.0} MiB",
        own.cpu_s,
        100.0 * own.cpu_share,
        own.rss_kib as f64 / 1024.0
    );
    match &own.slowdown {
        Some(cost) => {
            let ratio = |ratio: &crate::cost::Ratio| {
                let [low, high] = ratio.interval.map(|slower| 100.0 * slower);
                format!("{:+.2} % [{low:+.2}, {high:+.2}]", 100.0 * ratio.median)
            };
            let _ = writeln!(
                out,
                "  a tick takes {:.1} µs watched, {:.1} µs alone: {}",
                cost.tick_watched_us,
                cost.tick_alone_us,
                ratio(&cost.slower)
            );
            let _ = writeln!(
                out,
                "  the set uses {:.1} µs of processor time a tick watched, {:.1} µs alone: {}\n  \
                 (medians, {:.0} % intervals, over {} turns of {:.0} ms without and one more with the profiler, which then takes {:.2} % of a core)",
                cost.cpu_watched_us,
                cost.cpu_alone_us,
                ratio(&cost.more_cpu),
                100.0 * cost.confidence,
                cost.turns,
                cost.turn_ms,
                100.0 * cost.cpu_share
            );
        }
        None => *out += "  how much it slows a tick was not measured\n",
    }
}

/// What changed since an older profile.
pub fn changes(older: &Older, profile: &Profile, changes: &[Change]) -> String {
    let mut out = format!("\nThen: {}\n", conditions(&older.measured));
    let _ = writeln!(out, "Now: {}", conditions(&profile.measured));
    let of = |verdict| {
        changes
            .iter()
            .filter(move |change| change.verdict == verdict)
    };
    for (verdict, word) in [
        (ChangeVerdict::Slower, "slower"),
        (ChangeVerdict::Faster, "faster"),
    ] {
        for change in of(verdict) {
            let _ = writeln!(
                out,
                "  {word} {:>6.2} ×  {:<44} {:>10.1} → {:>10.1} µs  (p {:.1e})",
                change.ratio,
                change.figure,
                change.before as f64 / 1000.0,
                change.after as f64 / 1000.0,
                change.p
            );
        }
    }
    let _ = writeln!(
        out,
        "  {} slower, {} faster, {} within the noise, {} with too few samples to tell\n  \
         (rule: rank test over blocks of steps, 5 % over all figures by Holm, and at least 2 %; noise is what blocks of one run\n   \
         differ by: what two runs of the same program differ by, as on a machine with other work, comes on top)",
        of(ChangeVerdict::Slower).count(),
        of(ChangeVerdict::Faster).count(),
        of(ChangeVerdict::Same).count(),
        of(ChangeVerdict::Unknown).count()
    );
    out
}
