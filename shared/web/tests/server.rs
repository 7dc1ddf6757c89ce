//! The server over real sockets: first and last words, pages that do not read, and who is let in.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};
use web::{Access, Incoming, LIVE_VIEW, PageId, Server, Slot};

/// Nothing here takes as long: what does, hangs.
const PATIENCE: Duration = Duration::from_secs(60);

fn serve() -> (Access, Server) {
    let access = Access::new(Access::loopback()).unwrap();
    let server = Server::start(&access, LIVE_VIEW).unwrap();
    (access, server)
}

fn open(access: &Access) -> WebSocket<TcpStream> {
    let stream = TcpStream::connect(access.listen).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let url = format!("ws://{}/{}/socket", access.listen, access.token);
    tungstenite::client(url, stream).unwrap().0
}

fn next(server: &Server) -> Incoming {
    let since = Instant::now();
    loop {
        if let Some(incoming) = server.take() {
            return incoming;
        }
        assert!(since.elapsed() < PATIENCE, "nothing came in");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn joined(server: &Server) -> PageId {
    match next(server) {
        Incoming::Joined(page) => page,
        other => panic!("{other:?}"),
    }
}

/// The next text; none once the line is closed.
fn read(page: &mut WebSocket<TcpStream>) -> Option<String> {
    loop {
        match page.read() {
            Ok(Message::Text(text)) => return Some(text.as_str().to_owned()),
            Ok(Message::Close(_)) | Err(_) => return None,
            Ok(_) => {}
        }
    }
}

#[test]
fn a_page_is_told_first_what_every_page_is_told() {
    let (access, server) = serve();
    server.greet("hello");
    server.publish(Slot::Step, "step 1");
    let mut page = open(&access);
    let id = joined(&server);
    assert_eq!(read(&mut page).as_deref(), Some("hello"));
    assert_eq!(read(&mut page).as_deref(), Some("step 1"));
    server.tell("to all");
    server.tell_one(id, "to one");
    assert_eq!(read(&mut page).as_deref(), Some("to all"));
    assert_eq!(read(&mut page).as_deref(), Some("to one"));
    page.send(Message::text("I am here")).unwrap();
    assert_eq!(next(&server), Incoming::Said(id, "I am here".to_owned()));
    drop(page);
    assert_eq!(next(&server), Incoming::Left(id));
    assert_eq!(server.pages(), 0);
}

#[test]
fn a_page_that_reads_late_has_the_newest_state() {
    const STATES: usize = 10_000;
    let (access, server) = serve();
    let mut page = open(&access);
    joined(&server);
    let long = "x".repeat(10_000);
    for n in 0..STATES {
        server.publish(Slot::Motion, &format!("{n} {long}"));
    }
    server.publish(Slot::Motion, "last");
    let mut seen = 1;
    while read(&mut page).as_deref() != Some("last") {
        seen += 1;
    }
    assert!(seen < STATES, "nothing was left out");
}

#[test]
fn a_page_that_never_reads_is_let_go() {
    let (access, server) = serve();
    let page = open(&access);
    let id = joined(&server);
    let long = "x".repeat(1 << 20);
    for _ in 0..32 {
        server.tell(&long);
    }
    assert_eq!(next(&server), Incoming::Left(id));
    drop(page);
}

#[test]
fn the_last_word_arrives() {
    let (access, server) = serve();
    let mut page = open(&access);
    joined(&server);
    server.tell("over");
    drop(server);
    assert_eq!(read(&mut page).as_deref(), Some("over"));
    assert_eq!(read(&mut page), None);
    // Another server finds the address free.
    Server::start(&access, LIVE_VIEW).unwrap();
}

/// A page that is behind has the rest of a message, and more, before the last word.
#[test]
fn the_last_word_arrives_at_a_page_that_is_behind() {
    let (access, server) = serve();
    let mut page = open(&access);
    joined(&server);
    let long = "x".repeat(100_000);
    // More than the system keeps between the two.
    for _ in 0..70 {
        server.tell(&long);
    }
    server.tell("over");
    let ends = std::thread::spawn(move || drop(server));
    // The page reads once the server has begun to end: then nobody is let in any more.
    while TcpStream::connect(access.listen).is_ok() {}
    let last = std::iter::from_fn(|| read(&mut page)).last();
    assert_eq!(last.as_deref(), Some("over"));
    ends.join().unwrap();
}

#[test]
fn nobody_is_served_without_the_token() {
    let (access, server) = serve();
    let status = |path: &str| {
        let mut stream = TcpStream::connect(access.listen).unwrap();
        let host = access.listen;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer.split(' ').nth(1).unwrap().to_owned()
    };
    assert_eq!(status("/"), "401");
    assert_eq!(status(&format!("/{}/", "0".repeat(32))), "403");
    let wrong = format!("ws://{}/{}/socket", access.listen, "0".repeat(32));
    let stream = TcpStream::connect(access.listen).unwrap();
    assert!(tungstenite::client(wrong, stream).is_err());
    assert_eq!(server.take(), None);
}

/// Whatever a page sends, the server goes on.
#[test]
fn what_is_no_message_closes_the_page_alone() {
    let (access, server) = serve();
    let mut kept = open(&access);
    let keeps = joined(&server);
    let long = "y".repeat(100_000);
    let frames: [&[u8]; 5] = [
        &[0xff; 64],
        &[0x81, 0xfe, 0xff, 0xff],
        &[0x01, 0x02, b'a', b'b'],
        &[0x81, 0x82, 0, 0, 0, 0, 0xc3, 0x28],
        long.as_bytes(),
    ];
    for frame in frames {
        let mut page = open(&access);
        let id = joined(&server);
        let _ = page.get_mut().write_all(frame);
        drop(page);
        assert_eq!(next(&server), Incoming::Left(id));
    }
    server.tell_one(keeps, "still there");
    assert_eq!(read(&mut kept).as_deref(), Some("still there"));
}
