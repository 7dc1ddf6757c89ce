//! `profile.hlog`: all figures as HdrHistograms, in the interval log that HdrHistogram's tools of other languages read.

use crate::metrics::Samples;
use anyhow::{Context, Result, anyhow};
use hdrhistogram::Histogram;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};
use std::time::{Duration, SystemTime};

/// A figure's name as a tag: tags have neither blanks nor commas.
pub fn tag(name: &str) -> String {
    name.replace('→', "to").replace([' ', ','], "_")
}

/// The log: one interval over the whole observation per figure, values in ns, three significant digits, nothing
/// clipped.
///
/// # Errors
/// When a histogram cannot be made.
pub fn log(samples: &Samples, began: SystemTime, seconds: f64) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut serializer = V2DeflateSerializer::new();
    let mut builder = IntervalLogWriterBuilder::new();
    builder
        .add_comment("mirror profile: nanoseconds, one tag per figure")
        .with_start_time(began)
        .with_base_time(began)
        .with_max_value_divisor(1e6);
    let mut writer = builder.begin_log_with(&mut out, &mut serializer)?;
    for (name, samples) in samples.iter() {
        let mut histogram = Histogram::<u64>::new(3).context("a histogram")?;
        for ns in samples {
            histogram.record(*ns)?;
        }
        let tag = tag(name);
        let tag = Tag::new(&tag).with_context(|| format!("{tag:?} is no tag"))?;
        writer
            .write_histogram(
                &histogram,
                Duration::ZERO,
                Duration::from_secs_f64(seconds.max(0.0)),
                Some(tag),
            )
            .map_err(|error| anyhow!("{error}"))?;
    }
    Ok(out)
}
