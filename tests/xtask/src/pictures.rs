//! `cargo xtask pictures`: the pictures on the first page, of what the program makes now.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    browser::chromium,
    firmware::target_folder,
    toolchain::{self, call},
};

/// Folder of the pictures in the repository.
const PICTURES: &str = "docs/pictures";
/// Width and height of the picture of the report, pixels: its title and its map.
const SIZE: &str = "1100,1040";

/// Options of `cargo xtask pictures`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Pictures {
    /// Program that is already built; without one it is built in the release profile.
    program: Option<PathBuf>,
}

impl Pictures {
    /// Reads the words after `pictures`.
    ///
    /// # Errors
    /// The first word that is no option, or an option without its value.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        match words {
            [] => Ok(Self::default()),
            ["--program", program] => Ok(Self { program: Some(program.into()) }),
            ["--program"] => Err("`--program` needs a file".into()),
            [extra, ..] => Err(format!("`pictures` takes no `{extra}`")),
        }
    }

    /// Runs the demo and photographs its report.
    ///
    /// # Errors
    /// The program does not build, the demo fails, or there is no browser.
    pub(crate) fn make(&self, root: &Path) -> Result<(), String> {
        let target = target_folder(root)?;
        let program = match &self.program {
            Some(program) => std::path::absolute(program).map_err(|error| format!("{}: {error}", program.display()))?,
            None => {
                let mut build = Command::new(toolchain::cargo());
                call(build.args(["build", "--release", "--package", "r4"]).current_dir(root))?;
                target.join("release").join(format!("r4{}", env::consts::EXE_SUFFIX))
            }
        };
        let demo = target.join("pictures");
        fs::create_dir_all(&demo).map_err(|error| format!("{}: {error}", demo.display()))?;
        call(Command::new(&program).args(["demo", "--robot", "openscout"]).current_dir(&demo).stdout(Stdio::null()))?;
        let picture = root.join(PICTURES).join("openscout.png");
        let report = demo.join("r4-demo/report.html");
        photograph(&report, &picture, &demo.join("browser"))?;
        println!("{}", picture.display());
        Ok(())
    }
}

/// Writes what a browser shows of `page` to `picture`. The browser keeps its own files in `profile`.
fn photograph(page: &Path, picture: &Path, profile: &Path) -> Result<(), String> {
    let mut browser = Command::new(chromium()?);
    browser.args([
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--disable-background-networking",
    ]);
    browser.arg(format!("--user-data-dir={}", profile.display()));
    browser.arg(format!("--window-size={SIZE}")).arg(format!("--screenshot={}", picture.display()));
    call(browser.arg(format!("file://{}", page.display())).stderr(Stdio::null()))?;
    // It ends well also where it could not write.
    if picture.exists() { Ok(()) } else { Err(format!("the browser wrote no {}", picture.display())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read() {
        assert_eq!(Pictures::parse(&[]), Ok(Pictures { program: None }));
        assert_eq!(Pictures::parse(&["--program", "r4"]), Ok(Pictures { program: Some("r4".into()) }));
        assert!(Pictures::parse(&["--program"]).is_err_and(|problem| problem.contains("needs a file")));
        assert!(Pictures::parse(&["--large"]).is_err_and(|problem| problem.contains("--large")));
    }
}
