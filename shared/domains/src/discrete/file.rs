//! What the gridworlds' person files share: ten of them per domain, found by number.

use std::path::{Path, PathBuf};

use super::Domain;
use crate::highway::FileError;

/// People that ship for each domain.
pub const PEOPLE: u32 = 10;

/// The ten files of a domain.
macro_rules! ten_people {
    ($folder:literal) => {
        crate::discrete::file::ten_people!(@ $folder "01" "02" "03" "04" "05" "06" "07" "08" "09" "10")
    };
    (@ $folder:literal $($number:literal)*) => {
        [$(include_str!(concat!("../../people/", $folder, "/", $number, ".toml")),)*]
    };
}
pub(crate) use ten_people;

/// The name and text of person `id`'s file.
pub(crate) fn text_of(
    domain: Domain,
    people: &[&'static str; PEOPLE as usize],
    id: u32,
) -> Result<(PathBuf, &'static str), FileError> {
    let name = PathBuf::from(format!("people/{}/{id:02}.toml", domain.name()));
    let index = (id as usize).checked_sub(1);
    match index.and_then(|index| people.get(index)) {
        Some(text) => Ok((name, text)),
        None => Err(FileError::Range {
            file: Path::new("simulated people").to_owned(),
            key: "id".to_owned(),
            value: f64::from(id),
            expected: format!("1 to {PEOPLE}"),
        }),
    }
}
