//! A real browser for tests of the pages: Chromium without a window, spoken to by its DevTools protocol. Found as
//! `MIRROR_BROWSER`, or by the names that it has on the usual systems; nothing is downloaded.
#![allow(dead_code)] // Each test program uses its own part.

use serde_json::{Value, json};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// Nothing that a page does takes as long, even drawn by a busy processor.
const PATIENCE: Duration = Duration::from_secs(120);
/// Between two looks for something.
const LOOK: Duration = Duration::from_millis(20);
const NAMES: [&str; 5] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "/usr/bin/chromium",
];

/// Held by a test while it uses browsers: each draws with a processor of its own, and a page that gets none of it falls
/// silent.
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The browser's program; none where there is none.
pub fn found() -> Option<PathBuf> {
    let given = std::env::var_os("MIRROR_BROWSER").map(PathBuf::from);
    let named = NAMES.into_iter().map(PathBuf::from);
    given.into_iter().chain(named).find(|program| {
        let version = Command::new(program).arg("--version").output();
        version.is_ok_and(|version| version.status.success())
    })
}

/// A browser with a page.
pub struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    target: String,
    next: u64,
    /// What pages wrote to their consoles.
    pub console: VecDeque<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Opens a page; none, said as skipped, where there is no browser.
    pub fn open(test: &str, url: &str) -> Option<Self> {
        let Some(program) = found() else {
            testing::skipped(test, "no Chromium (MIRROR_BROWSER names one)");
            return None;
        };
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new(program)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-quic",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--disable-dev-shm-usage",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--ignore-gpu-blocklist",
                "--window-size=640,400",
                "--remote-debugging-port=0",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = lines.by_ref().map_while(Result::ok).find_map(|line| {
            let (_, address) = line.split_once("DevTools listening on ")?;
            Some(address.trim().to_owned())
        });
        let address = address.expect("the browser's address");
        // It goes on to write; nobody reads what.
        std::thread::spawn(move || lines.for_each(drop));
        let host = address.split('/').nth(2).unwrap();
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (socket, _) = tungstenite::client(address.as_str(), stream).unwrap();
        let mut browser = Self {
            child,
            socket,
            session: String::new(),
            target: String::new(),
            next: 0,
            console: VecDeque::new(),
            _profile: profile,
        };
        browser.open_page(url);
        Some(browser)
    }

    /// Opens another page, which is spoken to from now on.
    pub fn open_page(&mut self, url: &str) {
        self.session.clear();
        let target = self.call("Target.createTarget", json!({ "url": url }));
        self.target = target["targetId"].as_str().unwrap().to_owned();
        let attach = json!({ "targetId": self.target, "flatten": true });
        let attached = self.call("Target.attachToTarget", attach);
        self.session = attached["sessionId"].as_str().unwrap().to_owned();
        self.call("Runtime.enable", json!({}));
    }

    /// Closes the page.
    pub fn close_page(&mut self) {
        let target = self.target.clone();
        self.session.clear();
        self.call("Target.closeTarget", json!({ "targetId": target }));
    }

    /// Asks the browser for something.
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        let answered = self.try_call(method, params);
        answered.unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_call(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.next += 1;
        let mut message = json!({ "id": self.next, "method": method, "params": params });
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        self.socket
            .send(Message::text(message.to_string()))
            .unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let heard: Value = serde_json::from_str(&text).unwrap();
            if heard["id"] == self.next {
                return match &heard["error"] {
                    Value::Null => Ok(heard["result"].clone()),
                    error => Err(error.clone()),
                };
            }
            let method = heard["method"].as_str().unwrap_or_default();
            if method.starts_with("Runtime.") && method != "Runtime.executionContextCreated" {
                self.console.push_back(heard["params"].to_string());
            }
        }
    }

    /// The value of an expression on the page; null while the page is loading.
    pub fn value(&mut self, expression: &str) -> Value {
        let params = json!({
            "expression": expression,
            "returnByValue": true,
            "awaitPromise": true,
        });
        let result = self.try_call("Runtime.evaluate", params);
        result.map_or(Value::Null, |result| result["result"]["value"].clone())
    }

    /// Waits until an expression on the page is true.
    pub fn until(&mut self, expression: &str) {
        let since = Instant::now();
        let guarded = format!(
            "(() => {{ try {{ return Boolean({expression}) }} catch {{ return false }} }})()"
        );
        while self.value(&guarded) != true {
            let console = &self.console;
            assert!(since.elapsed() < PATIENCE, "{expression}: {console:?}");
            std::thread::sleep(LOOK);
        }
    }

    /// Holds a key down, such as `ArrowUp`.
    pub fn press(&mut self, code: &str) {
        self.key("rawKeyDown", code);
    }

    /// Lets it go.
    pub fn release(&mut self, code: &str) {
        self.key("keyUp", code);
    }

    fn key(&mut self, kind: &str, code: &str) {
        let number = match code {
            "Enter" => 13,
            "Escape" => 27,
            "ArrowLeft" => 37,
            "ArrowUp" => 38,
            "ArrowRight" => 39,
            "ArrowDown" => 40,
            _ => 0,
        };
        let params =
            json!({ "type": kind, "code": code, "key": code, "windowsVirtualKeyCode": number });
        self.call("Input.dispatchKeyEvent", params);
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
