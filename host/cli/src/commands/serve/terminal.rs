//! Pseudo-terminal of a served virtual board, with a symbolic link of a name that the user chose.

#[cfg(not(unix))]
pub(super) use absent::Terminal;
#[cfg(unix)]
pub(super) use unix::Terminal;

#[cfg(unix)]
mod unix {
    use std::{
        fs,
        path::{Path, PathBuf},
    };

    use anyhow::Context;
    use r4_links::{Descriptor, pty::Pty};

    /// Reason why a served board cannot have a name.
    #[derive(Debug, thiserror::Error)]
    enum NameTaken {
        #[error("{} is the name of a board that another program serves: end that, or choose another name", .0.display())]
        Served(PathBuf),
        #[error("{} leads to {}, which is no terminal of a board: choose another name, or remove it", .0.display(), .1.display())]
        Other(PathBuf, PathBuf),
    }

    /// Pseudo-terminal, with a symbolic link to it if a name was given.
    pub(in super::super) struct Terminal {
        pty: Pty,
        name: Option<Name>,
    }

    /// Symbolic link to a terminal, removed when dropped.
    struct Name {
        link: PathBuf,
        to: PathBuf,
        _claim: Claim,
    }

    impl Terminal {
        pub(in super::super) fn open(name: Option<&Path>) -> anyhow::Result<Self> {
            let pty = Pty::open().context("cannot make a pseudo-terminal")?;
            let name = name.map(|name| Name::take(name, pty.path())).transpose()?;
            Ok(Self { pty, name })
        }

        /// Path that a client opens.
        pub(in super::super) fn path(&self) -> &Path {
            self.name.as_ref().map_or(self.pty.path(), |name| &name.link)
        }

        pub(in super::super) fn descriptor(&self) -> &Descriptor {
            &self.pty.descriptor
        }
    }

    impl Name {
        /// Makes a symbolic link at `link`, replacing one left by a server that was killed.
        fn take(link: &Path, to: &Path) -> anyhow::Result<Self> {
            let claim = claim(link)?;
            if let Ok(old) = fs::read_link(link) {
                if old.parent() != to.parent() {
                    return Err(NameTaken::Other(link.to_owned(), old).into());
                }
                fs::remove_file(link).with_context(|| format!("cannot remove the old link {}", link.display()))?;
            }
            std::os::unix::fs::symlink(to, link).with_context(|| format!("cannot make the link {}", link.display()))?;
            Ok(Self { link: link.to_owned(), to: to.to_owned(), _claim: claim })
        }
    }

    impl Drop for Name {
        fn drop(&mut self) {
            // Keep a link that another program has redirected; a missing link needs no removal.
            if fs::read_link(&self.link).is_ok_and(|at| at == self.to) {
                let _ = fs::remove_file(&self.link);
            }
        }
    }

    /// Right to a name: a socket in Linux's abstract namespace, which ends with the process however that ends. A lock
    /// on the terminal would not do: the number of a dead server's terminal is soon reused.
    #[cfg(target_os = "linux")]
    type Claim = std::os::unix::net::UnixListener;

    #[cfg(target_os = "linux")]
    fn claim(name: &Path) -> anyhow::Result<Claim> {
        use std::{
            io,
            os::{linux::net::SocketAddrExt, unix::ffi::OsStrExt, unix::net::SocketAddr},
        };

        use sha2::{Digest, Sha256};

        let absolute = match (name.parent(), name.file_name()) {
            (Some(folder), Some(file)) => {
                let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
                fs::canonicalize(folder).with_context(|| format!("no folder for {}", name.display()))?.join(file)
            }
            _ => anyhow::bail!("{} is no name of a file", name.display()),
        };
        // An abstract name has at most 107 bytes; the digest has 64.
        let digest = Sha256::digest(absolute.as_os_str().as_bytes());
        let socket = digest.iter().fold("r4-served-".to_owned(), |name, byte| format!("{name}{byte:02x}"));
        let address = SocketAddr::from_abstract_name(socket).context("cannot claim a name")?;
        Claim::bind_addr(&address).map_err(|error| match error.kind() {
            io::ErrorKind::AddrInUse => NameTaken::Served(name.to_owned()).into(),
            _ => anyhow::Error::new(error).context("cannot claim a name"),
        })
    }

    #[cfg(not(target_os = "linux"))]
    struct Claim;

    /// Claims a name on other systems, where a name that leads to a terminal counts as served.
    #[cfg(not(target_os = "linux"))]
    fn claim(name: &Path) -> anyhow::Result<Claim> {
        use std::os::unix::fs::FileTypeExt;
        match fs::metadata(name).is_ok_and(|found| found.file_type().is_char_device()) {
            true => Err(NameTaken::Served(name.to_owned()).into()),
            false => Ok(Claim),
        }
    }
}

#[cfg(not(unix))]
mod absent {
    use std::path::Path;

    use r4_links::Descriptor;

    /// Error on systems without pseudo-terminals.
    #[derive(Debug, thiserror::Error)]
    #[error("this system has no pseudo-terminals: serve the board with --tcp 127.0.0.1:PORT")]
    struct NoTerminals;

    pub(in super::super) enum Terminal {}

    impl Terminal {
        pub(in super::super) fn open(_: Option<&Path>) -> anyhow::Result<Self> {
            Err(NoTerminals.into())
        }

        pub(in super::super) fn path(&self) -> &Path {
            match *self {}
        }

        pub(in super::super) fn descriptor(&self) -> &Descriptor {
            match *self {}
        }
    }
}
