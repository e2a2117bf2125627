//! Tasks that run beside the steps of `cargo xtask test`.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use crate::firmware;

/// Task of this program in a process of its own, which ends when this is dropped.
///
/// Linking an image or unpacking Python packages keeps one core busy: other steps use the other cores meanwhile.
pub(crate) struct Background {
    task: &'static str,
    child: Child,
    log: PathBuf,
}

impl Background {
    /// Starts a task, with its output in a file.
    ///
    /// # Errors
    /// This program cannot be started again, or the file not written.
    pub(crate) fn start(root: &Path, task: &'static str) -> Result<Self, String> {
        let log = firmware::target_folder(root)?.join(format!("{task}.log"));
        let failed = |error: std::io::Error| format!("{}: {error}", log.display());
        fs::create_dir_all(log.parent().unwrap_or(root)).map_err(failed)?;
        let file = File::create(&log).map_err(failed)?;
        let program = std::env::current_exe().map_err(|error| format!("this program's file is not known: {error}"))?;
        let mut command = Command::new(program);
        command.arg(task).current_dir(root).stdin(Stdio::null());
        command.stdout(file.try_clone().map_err(failed)?).stderr(file);
        let child = command.spawn().map_err(|error| format!("this program cannot be started again: {error}"))?;
        Ok(Self { task, child, log })
    }

    /// Waits for the end of the task and prints its output.
    ///
    /// # Errors
    /// The task failed; the output says why.
    pub(crate) fn finish(mut self) -> Result<(), String> {
        let status = self.child.wait().map_err(|error| error.to_string())?;
        print!("{}", fs::read_to_string(&self.log).unwrap_or_default());
        if status.success() { Ok(()) } else { Err(format!("`cargo xtask {}` failed, see above", self.task)) }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // Both fail for a process that has ended, as it should have.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
