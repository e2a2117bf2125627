//! Operating-system part of reading a key file.

pub(crate) use system::{has_data, is_open_to_others, is_pipe, open};

#[cfg(unix)]
mod system {
    use std::{
        fs::{File, Metadata},
        io,
        os::{
            fd::AsFd,
            unix::fs::{FileTypeExt, PermissionsExt},
        },
        path::Path,
    };

    use rustix::{
        event::{PollFd, PollFlags, Timespec, poll},
        fs::{Mode, OFlags},
    };

    /// Opens a file or a pipe. Does not wait for the writer of a pipe, because such a wait could not be interrupted.
    pub(crate) fn open(path: &Path) -> io::Result<File> {
        // CLOEXEC keeps the key from programs started meanwhile; NOCTTY keeps a terminal from becoming the controlling
        // one.
        let flags = OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
        Ok(File::from(rustix::fs::open(path, flags, Mode::empty())?))
    }

    /// Returns true if group or others have any permission.
    pub(crate) fn is_open_to_others(metadata: &Metadata) -> bool {
        // Group and others must have no permission at all: who can write the file can exchange the key.
        metadata.permissions().mode() & 0o077 != 0
    }

    pub(crate) fn is_pipe(metadata: &Metadata) -> bool {
        metadata.file_type().is_fifo()
    }

    /// Waits at most 50 ms for data; the end of the file counts as data.
    pub(crate) fn has_data(pipe: &File) -> io::Result<bool> {
        let mut waited = [PollFd::from_borrowed_fd(pipe.as_fd(), PollFlags::IN)];
        let timeout = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
        match poll(&mut waited, Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }
}

/// Windows: plain files only. There is no mode to check: a user's own folder is closed to others.
#[cfg(not(unix))]
mod system {
    use std::{
        fs::{File, Metadata},
        io,
        path::Path,
    };

    pub(crate) fn open(path: &Path) -> io::Result<File> {
        File::open(path)
    }

    pub(crate) fn is_open_to_others(_: &Metadata) -> bool {
        false
    }

    pub(crate) fn is_pipe(_: &Metadata) -> bool {
        false
    }

    pub(crate) fn has_data(_: &File) -> io::Result<bool> {
        Ok(true)
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::{
        fs::{self, Permissions},
        io,
        os::unix::fs::PermissionsExt,
        path::PathBuf,
    };

    use tempfile::TempDir;

    use crate::{Key, secure::KeyError};

    fn in_folder(name: &str) -> (TempDir, PathBuf) {
        let folder = TempDir::new().expect("a folder");
        let path = folder.path().join(name);
        (folder, path)
    }

    fn digits() -> String {
        "5a".repeat(32)
    }

    #[test]
    fn a_key_is_its_owners_alone() {
        let (_folder, path) = in_folder("key");
        fs::write(&path, digits()).expect("written");
        for mode in 0o400..=0o777 {
            fs::set_permissions(&path, Permissions::from_mode(mode)).expect("ours");
            match Key::read(&path) {
                Ok(key) => assert!(mode & 0o077 == 0 && key == Key::new([0x5a; 32]), "{mode:#o}"),
                Err(KeyError::Open(named)) => assert!(mode & 0o077 != 0 && named == path, "{mode:#o}"),
                Err(error) => panic!("{mode:#o}: {error}"),
            }
        }
    }

    #[test]
    fn a_key_is_64_digits_and_space_around_them() {
        let (_folder, path) = in_folder("key");
        let read = |text: &[u8]| {
            fs::write(&path, text).expect("written");
            fs::set_permissions(&path, Permissions::from_mode(0o600)).expect("ours");
            Key::read(&path)
        };
        let padded = |len: usize| [digits().into_bytes(), vec![b' '; len - 64]].concat();
        for good in [digits().into_bytes(), format!("  {}\r\n", digits()).into_bytes(), padded(600), padded(4096)] {
            assert_eq!(read(&good).expect("a key"), Key::new([0x5a; 32]));
        }
        for bad in [&b""[..], b"5a", b"\xff\xfe", &padded(4097), &padded(100_000), "5g".repeat(32).as_bytes()] {
            assert!(matches!(read(bad), Err(KeyError::Form(named)) if named == path), "{} bytes", bad.len());
        }
        // A folder can be opened, but reading it fails.
        let (folder, _) = in_folder("key");
        fs::set_permissions(folder.path(), Permissions::from_mode(0o700)).expect("ours");
        assert!(matches!(Key::read(folder.path()), Err(KeyError::Read { path, .. }) if path == folder.path()));
        fs::remove_file(&path).expect("it was there");
        assert!(
            matches!(Key::read(&path), Err(KeyError::Read { source, .. }) if source.kind() == io::ErrorKind::NotFound)
        );
    }

    /// The pipe is that of `--key <(command)`.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_key_may_come_through_a_pipe_whose_writer_is_waited_for() {
        let (_folder, path) = in_folder("pipe");
        use rustix::fs::{CWD, FileType, Mode, mknodat};
        // The pipe is not made by a command: handles that a started program inherits for a moment would disturb
        // parallel tests.
        mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("made");
        let mut asked = 0;
        let given_up = Key::read_while(&path, || {
            asked += 1;
            asked < 3
        });
        let interrupted = io::ErrorKind::Interrupted;
        assert!(matches!(given_up, Err(KeyError::Read { source, .. }) if source.kind() == interrupted));
        assert_eq!(asked, 3);
        let writer = path.clone();
        // Opening the pipe waits for its reader, so it runs in a thread.
        std::thread::spawn(move || fs::write(writer, digits()));
        let key = Key::read_while(&path, || {
            asked += 1;
            asked < 1000
        });
        assert_eq!(key.expect("it was written"), Key::new([0x5a; 32]));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn no_other_program_inherits_a_key() {
        let (_folder, path) = in_folder("key");
        fs::write(&path, digits()).expect("written");
        let file = super::open(&path).expect("opened");
        let flags = rustix::io::fcntl_getfd(&file).expect("open");
        assert!(flags.contains(rustix::io::FdFlags::CLOEXEC));
    }
}
