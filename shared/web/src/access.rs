//! Who is served: where the server listens, and the token that a link has to carry.

use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Random bytes of a token.
const TOKEN_BYTES: usize = 16;

/// Where pages are served, and to whom. Kept in a file of its own that only this user can read, because it holds the
/// token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Access {
    /// Address and port.
    pub listen: SocketAddr,
    /// What every path begins with: 32 hexadecimal digits.
    pub token: String,
}

/// Why access could not be prepared.
#[derive(Debug, Error)]
pub enum AccessError {
    /// The address is another machine's, or the port is taken.
    #[error("cannot listen on {listen}: {source}")]
    Listen {
        /// Where.
        listen: SocketAddr,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The system gives no random numbers.
    #[error("no random numbers for a token: {0}")]
    Random(std::io::Error),
    /// The file with the token cannot be written, read or understood.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

impl Access {
    /// A new token, and an address that nobody listens on now; where `listen` has port 0, a port of the system's
    /// choice, so that a server that is started again is found where it was.
    ///
    /// # Errors
    /// [`AccessError::Listen`], [`AccessError::Random`].
    pub fn new(listen: SocketAddr) -> Result<Self, AccessError> {
        let refused = |source| AccessError::Listen { listen, source };
        let probe = TcpListener::bind(listen).map_err(refused)?;
        let listen = probe.local_addr().map_err(refused)?;
        let mut random = [0; TOKEN_BYTES];
        File::open("/dev/urandom")
            .and_then(|mut source| source.read_exact(&mut random))
            .map_err(AccessError::Random)?;
        let token = random.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { listen, token })
    }

    /// This machine alone, any port.
    pub fn loopback() -> SocketAddr {
        SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0)
    }

    /// The link to open.
    pub fn link(&self) -> String {
        // Who listens everywhere is reached here by the machine's own address.
        let mut shown = self.listen;
        if shown.ip().is_unspecified() {
            shown.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
        }
        format!("http://{shown}/{}/", self.token)
    }

    /// Writes it to a file that only this user can read.
    ///
    /// # Errors
    /// [`AccessError::File`].
    pub fn save(&self, path: &Path) -> Result<(), AccessError> {
        let failed = |reason: String| AccessError::File {
            path: path.to_owned(),
            reason,
        };
        let text = serde_json::to_vec(self).map_err(|error| failed(error.to_string()))?;
        let mut options = std::fs::OpenOptions::new();
        options.write(true).create(true).truncate(true).mode(0o600);
        options
            .open(path)
            .and_then(|mut file| file.write_all(&text))
            .map_err(|error| failed(error.to_string()))
    }

    /// Reads what [`Access::save`] wrote.
    ///
    /// # Errors
    /// [`AccessError::File`].
    pub fn load(path: &Path) -> Result<Self, AccessError> {
        let failed = |reason: String| AccessError::File {
            path: path.to_owned(),
            reason,
        };
        let text = std::fs::read(path).map_err(|error| failed(error.to_string()))?;
        serde_json::from_slice(&text).map_err(|error| failed(error.to_string()))
    }

    /// Whether this is the token. Takes as long for every wrong one of its length, so that nobody guesses it digit by
    /// digit.
    pub fn admits(&self, token: &str) -> bool {
        let (ours, theirs) = (self.token.as_bytes(), token.as_bytes());
        let differs = ours
            .iter()
            .zip(theirs)
            .fold(0, |differs, (a, b)| std::hint::black_box(differs | (a ^ b)));
        !ours.is_empty() && ours.len() == theirs.len() && differs == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn every_access_has_a_token_and_a_port_of_its_own() {
        let access = Access::new(Access::loopback()).unwrap();
        assert_eq!(access.token.len(), 2 * TOKEN_BYTES);
        assert_ne!(access.token, Access::new(Access::loopback()).unwrap().token);
        assert_ne!(access.listen.port(), 0);
        assert!(access.link().starts_with("http://127.0.0.1:"));
        assert!(access.link().ends_with(&format!("/{}/", access.token)));
    }

    #[test]
    fn only_the_whole_token_is_admitted() {
        let access = Access::new(Access::loopback()).unwrap();
        assert!(access.admits(&access.token));
        for place in 0..access.token.len() {
            let mut wrong = access.token.clone().into_bytes();
            wrong[place] ^= 1;
            assert!(!access.admits(std::str::from_utf8(&wrong).unwrap()));
            assert!(!access.admits(&access.token[..place]));
        }
        assert!(!access.admits(&format!("{}0", access.token)));
        let listen = access.listen;
        let nothing = Access {
            listen,
            token: String::new(),
        };
        assert!(!nothing.admits(""));
    }

    #[test]
    fn the_file_is_this_users_alone() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("access.json");
        let access = Access::new(Access::loopback()).unwrap();
        access.save(&path).unwrap();
        assert_eq!(Access::load(&path).unwrap(), access);
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        std::fs::write(&path, "{}").unwrap();
        let error = Access::load(&path).unwrap_err().to_string();
        assert!(error.contains("access.json"), "{error}");
    }
}
