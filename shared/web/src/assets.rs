//! The pages' files, compiled into the program: made by `web/build.mjs`, which says what of.

/// A file.
#[derive(Debug, PartialEq, Eq)]
pub struct Asset {
    /// Its path behind the token and the slash.
    pub path: &'static str,
    /// Its type, as browsers want it.
    pub kind: &'static str,
    /// Its bytes.
    pub bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

macro_rules! asset {
    ($path:literal, $kind:expr, $file:literal) => {
        Asset {
            path: $path,
            kind: $kind,
            bytes: include_bytes!(concat!("../../../web/dist/", $file)),
        }
    };
}

/// The cockpit: a person at the wheel.
pub const COCKPIT: &[Asset] = &[
    asset!("", HTML, "cockpit.html"),
    asset!("cockpit.js", SCRIPT, "cockpit.js"),
    asset!("style.css", STYLE, "style.css"),
    asset!("inter.woff2", "font/woff2", "inter.woff2"),
    asset!("sentences.json", "application/json", "sentences.json"),
    asset!("sentences.bin", "application/octet-stream", "sentences.bin"),
    asset!("licences.txt", "text/plain; charset=utf-8", "licences.txt"),
];

/// The live view: a run, watched.
pub const LIVE_VIEW: &[Asset] = &[
    asset!("", HTML, "view.html"),
    asset!("view.js", SCRIPT, "view.js"),
    asset!("style.css", STYLE, "style.css"),
    asset!("inter.woff2", "font/woff2", "inter.woff2"),
    asset!("licences.txt", "text/plain; charset=utf-8", "licences.txt"),
];
