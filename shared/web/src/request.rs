//! One HTTP request: read, checked, and answered with a file or with why not. Everything that a page needs is a GET of
//! a small file, so a connection carries one request.

use crate::access::Access;
use crate::assets::Asset;
use std::io::{self, Read, Write};
use std::net::{IpAddr, TcpStream};
use std::time::{Duration, Instant};

/// Longest head of a request.
pub const MOST_BYTES: usize = 8 << 10;
/// Most headers in it.
const MOST_HEADERS: usize = 64;
/// How long a request may take to arrive.
const PATIENCE: Duration = Duration::from_secs(5);

/// What was asked for, as far as the server cares.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// Such as `GET`.
    pub method: String,
    /// The path, without what follows a question mark.
    pub path: String,
    /// The host that the page's address names.
    pub host: Option<String>,
    /// The page that asks.
    pub origin: Option<String>,
    /// The key of a WebSocket handshake.
    pub key: Option<String>,
}

/// What becomes of a request.
#[derive(Debug, PartialEq, Eq)]
pub enum Answer<'a> {
    /// A file.
    File(&'a Asset),
    /// The page's WebSocket; the key that the client sent.
    Socket(&'a str),
    /// No: status and what it means.
    Refused(u16, &'static str),
}

/// Reads a request's head; none if the other side sends no HTTP, too much, or too slowly.
pub fn read(stream: &mut TcpStream) -> Option<Request> {
    let until = Instant::now() + PATIENCE;
    let mut bytes = Vec::with_capacity(1024);
    let mut piece = [0; 1024];
    loop {
        let left = until.checked_duration_since(Instant::now())?;
        stream
            .set_read_timeout(Some(left.max(Duration::from_millis(1))))
            .ok()?;
        match stream.read(&mut piece) {
            Ok(0) => return None,
            Ok(read) => bytes.extend_from_slice(&piece[..read]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return None,
        }
        match parse(&bytes) {
            Parsed::Whole(request) => return Some(request),
            Parsed::Part if bytes.len() < MOST_BYTES => {}
            _ => return None,
        }
    }
}

/// How far a request has come.
#[derive(Debug, PartialEq, Eq)]
pub enum Parsed {
    /// All of it is there.
    Whole(Request),
    /// More is to come.
    Part,
    /// It is none.
    Nonsense,
}

/// Reads a request's head from what has arrived.
pub fn parse(bytes: &[u8]) -> Parsed {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut head = httparse::Request::new(&mut headers);
    match head.parse(bytes) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) => return Parsed::Part,
        Err(_) => return Parsed::Nonsense,
    }
    let target = head.path.unwrap_or_default();
    let mut request = Request {
        method: head.method.unwrap_or_default().to_owned(),
        path: target
            .split(['?', '#'])
            .next()
            .unwrap_or_default()
            .to_owned(),
        ..Request::default()
    };
    let mut upgrades = false;
    for header in head.headers.iter() {
        let Ok(value) = std::str::from_utf8(header.value) else {
            continue;
        };
        let value = value.trim();
        let field = match header.name.to_ascii_lowercase().as_str() {
            "host" => &mut request.host,
            "origin" => &mut request.origin,
            "sec-websocket-key" => &mut request.key,
            "upgrade" => {
                upgrades |= value.eq_ignore_ascii_case("websocket");
                continue;
            }
            _ => continue,
        };
        // Of two that differ nobody knows which one somebody else has checked.
        if field.as_deref().is_some_and(|given| given != value) {
            return Parsed::Nonsense;
        }
        *field = Some(value.to_owned());
    }
    request.key = request.key.filter(|_| upgrades);
    Parsed::Whole(request)
}

/// What becomes of a request: files and the socket lie below the token.
pub fn answer<'a>(request: &'a Request, access: &Access, assets: &'a [Asset]) -> Answer<'a> {
    let Some(host) = request.host.as_deref().filter(|host| is_own(host)) else {
        return Answer::Refused(403, "this server has no such name");
    };
    let is_other = |origin: &str| {
        let (_, authority) = origin.split_once("://").unwrap_or_default();
        !authority.eq_ignore_ascii_case(host)
    };
    if request.origin.as_deref().is_some_and(is_other) {
        return Answer::Refused(403, "another site's page asks");
    }
    let path = request.path.strip_prefix('/').unwrap_or_default();
    let (token, file) = path.split_once('/').unwrap_or((path, ""));
    if token.is_empty() {
        return Answer::Refused(401, "this page has a link of its own, with a token in it");
    }
    if !access.admits(token) {
        return Answer::Refused(403, "this link is none of this run's");
    }
    if request.method != "GET" {
        return Answer::Refused(405, "there is nothing to send here");
    }
    if file == "socket" {
        return match &request.key {
            Some(key) => Answer::Socket(key),
            None => Answer::Refused(400, "this is a WebSocket"),
        };
    }
    // Without the slash, what the page names would be looked for beside the token.
    if !path.contains('/') {
        return Answer::Refused(404, "the link ends with a slash");
    }
    match assets.iter().find(|asset| asset.path == file) {
        Some(asset) => Answer::File(asset),
        None => Answer::Refused(404, "there is no such file"),
    }
}

/// Whether a host is named as this server is: by an address, or as the machine itself. A name in the DNS could be
/// another site's that has come to point here.
fn is_own(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let bare = name
        .strip_prefix('[')
        .and_then(|name| name.strip_suffix(']'))
        .unwrap_or(name);
    name.eq_ignore_ascii_case("localhost") || bare.parse::<IpAddr>().is_ok()
}

/// What every answer says about itself: nothing is cached, framed, or sent on, and a page runs what came with it.
const COMMON: &str = "Connection: close\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
    Referrer-Policy: no-referrer\r\nCross-Origin-Opener-Policy: same-origin\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; \
    object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n";

/// Writes a file.
///
/// # Errors
/// The connection's.
pub fn write_file(stream: &mut impl Write, asset: &Asset) -> io::Result<()> {
    let (kind, length) = (asset.kind, asset.bytes.len());
    write!(
        stream,
        "HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n{COMMON}\r\n"
    )?;
    stream.write_all(asset.bytes)?;
    stream.flush()
}

/// Writes why not.
///
/// # Errors
/// The connection's.
pub fn write_refusal(stream: &mut impl Write, status: u16, why: &str) -> io::Result<()> {
    let length = why.len() + 1;
    write!(
        stream,
        "HTTP/1.1 {status} Refused\r\nContent-Type: text/plain; charset=utf-8\r\n\
         Content-Length: {length}\r\n{COMMON}\r\n{why}\n"
    )?;
    stream.flush()
}

/// Writes the answer to a WebSocket's handshake.
///
/// # Errors
/// The connection's.
pub fn write_upgrade(stream: &mut impl Write, key: &str) -> io::Result<()> {
    let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
    write!(
        stream,
        "HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Accept: {accept}\r\n\r\n"
    )?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ASSETS: &[Asset] = &[Asset {
        path: "",
        kind: "text/html",
        bytes: b"<p>",
    }];

    fn access() -> Access {
        Access {
            listen: Access::loopback(),
            token: "00112233".to_owned(),
        }
    }

    fn status(path: &str, more: &str) -> u16 {
        let text = format!("GET {path} HTTP/1.1\r\n{more}\r\n");
        let Parsed::Whole(request) = parse(text.as_bytes()) else {
            panic!("{text}");
        };
        match answer(&request, &access(), ASSETS) {
            Answer::File(_) => 200,
            Answer::Socket(_) => 101,
            Answer::Refused(status, _) => status,
        }
    }

    #[test]
    fn the_link_is_needed() {
        let host = "Host: 127.0.0.1:8080\r\n";
        assert_eq!(status("/00112233/", host), 200);
        assert_eq!(status("/00112233/?round=1", host), 200);
        assert_eq!(status("/", host), 401);
        assert_eq!(status("/00112234/", host), 403);
        assert_eq!(status("/00112233", host), 404);
        assert_eq!(status("/00112233/../../etc/passwd", host), 404);
    }

    #[test]
    fn another_sites_name_or_page_is_refused() {
        for host in ["localhost:1", "127.0.0.1", "[::1]:8080", "192.168.1.7:80"] {
            assert_eq!(status("/00112233/", &format!("Host: {host}\r\n")), 200);
            let own = format!("Host: {host}\r\nOrigin: http://{host}\r\n");
            assert_eq!(status("/00112233/", &own), 200);
            let other = format!("Host: {host}\r\nOrigin: https://evil.example\r\n");
            assert_eq!(status("/00112233/", &other), 403);
            let null = format!("Host: {host}\r\nOrigin: null\r\n");
            assert_eq!(status("/00112233/", &null), 403);
        }
        for host in [
            "evil.example",
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "",
        ] {
            assert_eq!(status("/00112233/", &format!("Host: {host}\r\n")), 403);
        }
        assert_eq!(status("/00112233/", ""), 403);
        let twice = b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n";
        assert_eq!(parse(twice), Parsed::Nonsense);
    }

    #[test]
    fn a_socket_needs_its_handshake() {
        let host = "Host: localhost\r\n";
        assert_eq!(status("/00112233/socket", host), 400);
        let upgrade = format!("{host}Upgrade: websocket\r\nSec-WebSocket-Key: abc\r\n");
        assert_eq!(status("/00112233/socket", &upgrade), 101);
        assert_eq!(status("/99112233/socket", &upgrade), 403);
    }

    proptest! {
        #[test]
        fn whatever_arrives_is_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..512)) {
            if let Parsed::Whole(request) = parse(&bytes) {
                let answer = answer(&request, &access(), ASSETS);
                prop_assert!(request.path.contains("00112233") || matches!(answer, Answer::Refused(..)));
            }
        }

        #[test]
        fn no_path_leads_past_the_token(path in "[ -~]{0,40}", host in "[ -~]{0,20}") {
            let text = format!("GET /{path} HTTP/1.1\r\nHost: {host}\r\n\r\n");
            if let Parsed::Whole(request) = parse(text.as_bytes()) {
                let answer = answer(&request, &access(), ASSETS);
                let is_admitted = request.path.starts_with("/00112233/");
                prop_assert!(is_admitted || matches!(answer, Answer::Refused(..)));
            }
        }
    }
}
