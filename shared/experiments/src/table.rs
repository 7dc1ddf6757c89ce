//! CSV files that can be continued: an experiment that was stopped skips the rows it already has.

use anyhow::Context;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// A CSV file whose first columns name a row.
pub struct Table {
    path: PathBuf,
    file: Mutex<File>,
    done: BTreeSet<String>,
}

impl Table {
    /// Opens or begins a table; `key` columns name a row, and numbers follow. Rows that no study writes are dropped, to be done
    /// again: half ones, and those with something else than a finite number where one belongs.
    ///
    /// # Errors
    /// If the file cannot be written, or has other columns.
    pub fn open(path: &Path, header: &str, key: usize) -> anyhow::Result<Self> {
        files::check_regular(path)?;
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(e).with_context(|| path.display().to_string()),
        };
        let columns = header.split(',').count();
        let mut kept = format!("{header}\n");
        let mut done = BTreeSet::new();
        if !text.is_empty() {
            let whole = text.rfind('\n').map_or("", |end| &text[..end]);
            let mut lines = whole.lines();
            anyhow::ensure!(
                lines.next().is_none_or(|first| first == header),
                "{}: line 1 names other columns than this experiment writes; choose another --out",
                path.display()
            );
            for line in lines.filter(|line| is_row(line, columns, key)) {
                if done.insert(key_of(line, key)) {
                    kept.push_str(line);
                    kept.push('\n');
                }
            }
        }
        replace(path, &kept)?;
        let file = files::log(path, true)?;
        Ok(Self {
            path: path.to_owned(),
            file: Mutex::new(file),
            done,
        })
    }

    /// Whether a row with this key was there when the table was opened.
    pub fn has(&self, key: &str) -> bool {
        self.done.contains(key)
    }

    /// Appends rows at once.
    ///
    /// # Errors
    /// If the disk does not take them.
    pub fn append(&self, rows: &str) -> anyhow::Result<()> {
        let mut file = self
            .file
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        file.write_all(rows.as_bytes())
            .and_then(|()| file.flush())
            .with_context(|| self.path.display().to_string())
    }

    /// Sorts the finished table by key, so that its bytes do not depend on which core was faster, and returns its rows.
    ///
    /// # Errors
    /// If the file cannot be read or written.
    pub fn finish(self) -> anyhow::Result<Vec<Vec<String>>> {
        let text =
            std::fs::read_to_string(&self.path).with_context(|| self.path.display().to_string())?;
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default().to_owned();
        let mut rows: Vec<&str> = lines.collect();
        rows.sort_unstable_by_key(|line| {
            line.split(',')
                .map(|cell| match cell.parse::<u64>() {
                    Ok(number) => format!("{number:020}"),
                    Err(_) => cell.to_owned(),
                })
                .collect::<Vec<_>>()
        });
        let sorted = format!("{header}\n{}\n", rows.join("\n"));
        replace(&self.path, &sorted)?;
        Ok(rows
            .iter()
            .map(|row| row.split(',').map(str::to_owned).collect())
            .collect())
    }
}

/// Keeps what a study's rows depend on in `path`, so that nobody continues it with other settings.
///
/// # Errors
/// If the file says otherwise, or cannot be written.
pub fn ensure_same(path: &Path, about: &serde_json::Value) -> anyhow::Result<()> {
    files::check_regular(path)?;
    match std::fs::read_to_string(path) {
        Ok(text) => {
            // It is written whole or not at all: whatever else stands there, the rows beside it may be of any study.
            let before: serde_json::Value = serde_json::from_str(&text).with_context(|| {
                format!(
                    "{}: not a study's settings; choose another --out",
                    path.display()
                )
            })?;
            // As it reads from a file: the last digit of a number may change on the way.
            let about: serde_json::Value = serde_json::from_str(&about.to_string())?;
            anyhow::ensure!(
                before == about,
                "{}: this folder holds a study with other settings; choose another --out",
                path.display()
            );
            return Ok(());
        }
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
        Err(e) => return Err(e).with_context(|| path.display().to_string()),
    }
    replace(path, &format!("{about:#}\n"))
}

/// Writes a file whole or not at all: see [`files::write`].
///
/// # Errors
/// Names the file that cannot be written.
pub(crate) fn replace(path: &Path, text: &str) -> anyhow::Result<()> {
    Ok(files::write(path, text.as_bytes())?)
}

/// Writes a report as JSON, whole or not at all.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_json(path: &Path, report: &impl serde::Serialize) -> anyhow::Result<()> {
    replace(path, &serde_json::to_string_pretty(report)?)
}

fn is_row(line: &str, columns: usize, key: usize) -> bool {
    let mut cells = line.split(',');
    cells.clone().count() == columns
        && cells.by_ref().take(key).all(|cell| !cell.is_empty())
        && cells.all(|cell| cell.parse().is_ok_and(f64::is_finite))
}

fn key_of(line: &str, columns: usize) -> String {
    line.split(',').take(columns).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_settings_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("s.json");
        let about = serde_json::json!({"rounds": 6, "cost": 0.02_f32});
        ensure_same(&path, &about).expect("new");
        ensure_same(&path, &about).expect("the same");
        let error = ensure_same(&path, &serde_json::json!({"rounds": 5})).expect_err("other");
        assert!(error.to_string().contains("s.json"), "{error}");
        // Nobody knows what the rows beside a damaged one depend on.
        std::fs::write(&path, "{\"rou").expect("written");
        let error = format!("{:#}", ensure_same(&path, &about).expect_err("damaged"));
        assert!(error.contains("s.json: not a study's settings"), "{error}");
    }

    #[test]
    fn what_cannot_be_read_back_is_no_table() {
        let error = Table::open(Path::new("/dev/null"), "a,b", 1)
            .err()
            .expect("a device");
        assert!(error.to_string().contains("/dev/null"), "{error}");
    }

    #[test]
    fn continues_where_it_was_cut() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("t.csv");
        std::fs::write(&path, "a,b,c\n1,x,3\n2,y,4\n3,z").expect("written");
        let table = Table::open(&path, "a,b,c", 2).expect("opened");
        assert!(table.has("1,x") && table.has("2,y") && !table.has("3,z"));
        table.append("10,q,1\n").expect("appended");
        table.append("3,z,5\n").expect("appended");
        let rows = table.finish().expect("finished");
        assert_eq!(rows.len(), 4);
        assert_eq!(rows[3][0], "10");
        assert!(Table::open(&path, "a,b", 1).is_err());
    }

    /// A row with a damaged number is no row: it would be a NaN in every mean.
    #[test]
    fn damaged_rows_are_done_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("t.csv");
        std::fs::write(
            &path,
            "a,b,c\n1,x,3\n2,y,4o\n3,z,NaN\n4,z,\n,z,1\n5,u,-1e-3\n",
        )
        .expect("written");
        let table = Table::open(&path, "a,b,c", 2).expect("opened");
        let known = ["1,x", "2,y", "3,z", "4,z", ",z", "5,u"].map(|key| table.has(key));
        assert_eq!(known, [true, false, false, false, false, true]);
        assert_eq!(table.finish().expect("finished").len(), 2);
    }
}
