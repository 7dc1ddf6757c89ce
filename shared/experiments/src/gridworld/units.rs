//! A study in units: pure functions of (settings, key), done in any order on all cores, each writing its rows at once. Stopped and
//! started again, a study does what is missing and ends with the same table.

use crate::table::{Table, ensure_same};
use anyhow::Context;
use rayon::prelude::*;
use std::io::Write;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// What a study's table is.
pub struct Sheet<'a> {
    /// Folder.
    pub out: &'a Path,
    /// Name of its files.
    pub name: &'a str,
    /// Columns.
    pub header: &'a str,
    /// How many of them name a row.
    pub key: usize,
    /// What the rows depend on beside their keys.
    pub about: serde_json::Value,
}

/// A piece of a study.
pub trait Unit: Sync {
    /// Keys of the rows that it writes.
    fn keys(&self) -> Vec<String>;

    /// About how long it takes, in any measure that is the same for all.
    fn effort(&self) -> usize;

    /// Its rows, each `key,…` without the line's end, in the order of [`Unit::keys`].
    ///
    /// # Errors
    /// What went wrong.
    fn rows(&self) -> anyhow::Result<Vec<String>>;
}

/// What a study's run gave.
pub struct Done {
    /// All rows, sorted by key.
    pub rows: Vec<Vec<String>>,
    /// Seconds of all pieces, summed over the cores, in this run and those before it.
    pub work_s: f64,
}

/// Does the units whose rows are missing. `progress` hears of (done, all), by effort.
///
/// # Errors
/// If a unit fails, `out` cannot be written, or it holds a study with other settings.
pub fn run<U: Unit>(
    sheet: &Sheet,
    units: &[U],
    progress: &(dyn Fn(usize, usize) + Sync),
) -> anyhow::Result<Done> {
    let Sheet { out, name, .. } = sheet;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    ensure_same(&out.join(format!("{name}.settings.json")), &sheet.about)?;
    let table = Table::open(&out.join(format!("{name}.csv")), sheet.header, sheet.key)?;
    let times = out.join(format!("{name}.times.csv"));
    files::check_regular(&times)?;
    let clock = Mutex::new(files::log(&times, true)?);
    let missing: Vec<&U> = units
        .iter()
        .filter(|unit| unit.keys().iter().any(|key| !table.has(key)))
        .collect();
    let total = missing.iter().map(|unit| unit.effort()).sum();
    let done = AtomicUsize::new(0);
    progress(0, total);
    missing.par_iter().with_max_len(1).try_for_each(|unit| {
        let started = Instant::now();
        let (keys, rows) = (unit.keys(), unit.rows()?);
        let mut text = String::new();
        // Of a unit that was cut off, some rows may be there.
        for (_, row) in keys.iter().zip(&rows).filter(|(key, _)| !table.has(key)) {
            text.push_str(row);
            text.push('\n');
        }
        table.append(&text)?;
        let key = keys.first().map_or("", String::as_str).replace(',', " ");
        let line = format!("{key},{:.3}\n", started.elapsed().as_secs_f64());
        clock
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
            .write_all(line.as_bytes())
            .with_context(|| times.display().to_string())?;
        let effort = unit.effort();
        let before = done.fetch_add(effort, Ordering::Relaxed);
        progress(before + effort, total);
        anyhow::Ok(())
    })?;
    let text = std::fs::read_to_string(&times).with_context(|| times.display().to_string())?;
    let seconds = text.lines().filter_map(|line| line.rsplit_once(','));
    let work_s = seconds.filter_map(|(_, s)| s.parse::<f64>().ok()).sum();
    Ok(Done {
        rows: table.finish()?,
        work_s,
    })
}

/// A cell as a number.
pub fn number(row: &[String], column: usize) -> f64 {
    row.get(column)
        .and_then(|cell| cell.parse().ok())
        .unwrap_or(f64::NAN)
}

/// Mean of each person's values (`person` is the column of their number): one value a person, in the order of their numbers.
pub fn by_person(
    rows: &[&Vec<String>],
    person: usize,
    value: &dyn Fn(&[String]) -> f64,
) -> Vec<f64> {
    let mut sums: std::collections::BTreeMap<u32, (f64, f64)> = Default::default();
    for row in rows {
        let id = number(row, person) as u32;
        let (sum, count) = sums.entry(id).or_default();
        *sum += value(row);
        *count += 1.0;
    }
    sums.values().map(|(sum, count)| sum / count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Squares(u64);

    impl Unit for Squares {
        fn keys(&self) -> Vec<String> {
            (0..3).map(|i| format!("{},{i}", self.0)).collect()
        }

        fn effort(&self) -> usize {
            1
        }

        fn rows(&self) -> anyhow::Result<Vec<String>> {
            let row = |i: u64| format!("{},{i},{}", self.0, (self.0 + i) * (self.0 + i));
            Ok((0..3).map(row).collect())
        }
    }

    fn sheet(out: &Path, about: u32) -> Sheet<'_> {
        Sheet {
            out,
            name: "squares",
            header: "a,b,square",
            key: 2,
            about: serde_json::json!(about),
        }
    }

    #[test]
    fn cut_anywhere_and_continued_the_table_is_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let units: Vec<Squares> = (0..7).map(Squares).collect();
        let whole = folder.path().join("whole");
        let done = run(&sheet(&whole, 1), &units, &|_, _| {}).expect("run");
        assert_eq!(done.rows.len(), 21);
        let text = std::fs::read_to_string(whole.join("squares.csv")).expect("there");
        for cut in 0..=text.len() {
            let out = folder.path().join("cut");
            std::fs::create_dir_all(&out).expect("made");
            std::fs::write(out.join("squares.csv"), &text[..cut]).expect("written");
            run(&sheet(&out, 1), &units, &|_, _| {}).expect("run");
            let again = std::fs::read_to_string(out.join("squares.csv")).expect("there");
            assert_eq!(again, text, "cut at {cut}");
        }
        run(&sheet(&whole, 1), &units, &|done, all| {
            assert_eq!((done, all), (0, 0));
        })
        .expect("nothing left to do");
        let error = run(&sheet(&whole, 2), &units, &|_, _| {})
            .err()
            .expect("other");
        assert!(
            error.to_string().contains("squares.settings.json"),
            "{error}"
        );
    }

    #[test]
    fn people_weigh_the_same() {
        let rows: Vec<Vec<String>> = [["1", "2"], ["1", "4"], ["2", "10"]]
            .iter()
            .map(|row| row.iter().map(|cell| (*cell).to_owned()).collect())
            .collect();
        let rows: Vec<&Vec<String>> = rows.iter().collect();
        assert_eq!(by_person(&rows, 0, &|row| number(row, 1)), [3.0, 10.0]);
    }
}
