//! Task `cargo xtask weight`: the cost of building the program from an empty folder, by crate.
//!
//! Cargo calls this program in place of each compiler (`RUSTC_WRAPPER`), so that every crate is charged with the
//! processor time of its own compilers. The rest is the time of build scripts and cargo itself.

use std::{
    collections::{BTreeMap, VecDeque},
    env, fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use serde_json::{Value, json};

use crate::{
    firmware::target_folder,
    meter::{Cost, Meter},
    toolchain::{self, Node},
};

/// Budget of processor time for the build for `r4 demo`, s.
const PROCESSOR_BUDGET_S: f64 = 400.0;
/// Budget of the released program's size, bytes.
const SIZE_BUDGET: u64 = 15_000_000;
/// Number of slow crates that are listed.
const SLOWEST: usize = 10;
/// Variable with the path of a file for compilers' times, one line for each crate. Set for compilers only.
const TIMES: &str = "R4_XTASK_TIMES";
/// Package of the program.
const PROGRAM: &str = "r4";

/// Options of `cargo xtask weight`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Weight {
    /// True to build with the profile of releases.
    dist: bool,
    json: bool,
}

/// Result of the build.
struct Report {
    whole: Cost,
    /// Size of the program, bytes.
    size: u64,
    crates: Vec<Crate>,
}

/// Package, or a part of one: its library, its build script.
#[derive(Debug, PartialEq)]
struct Crate {
    name: String,
    seconds: f64,
    /// Path of dependencies from the program to the package: each is one of the previous.
    chain: Vec<String>,
}

impl Weight {
    /// Reads the words after `weight`.
    ///
    /// # Errors
    /// The word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut weight = Self::default();
        for word in words {
            match *word {
                "--dist" => weight.dist = true,
                "--json" => weight.json = true,
                other => return Err(format!("`weight` takes no `{other}`")),
            }
        }
        Ok(weight)
    }

    /// Builds, and prints the cost.
    pub(crate) fn run(self, root: &Path) -> ExitCode {
        let report = match self.build(root) {
            Ok(report) => report,
            Err(problem) => {
                eprintln!("error: {problem}");
                return ExitCode::FAILURE;
            }
        };
        if self.json {
            println!("{}", self.object(&report));
        } else {
            self.print(&report);
        }
        if self.held(&report) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }

    fn build(self, root: &Path) -> Result<Report, String> {
        let target = target_folder(root)?.join("weight");
        let profile = if self.dist { "dist" } else { "release" };
        match fs::remove_dir_all(&target) {
            // A folder with old crates would make the build look cheap.
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(format!("{}: {error}", target.display()));
            }
            _ => {}
        }
        fs::create_dir_all(&target).map_err(|error| format!("{}: {error}", target.display()))?;
        let times = target.join("times");
        let this = env::current_exe().map_err(|error| format!("this program has no path: {error}"))?;
        let mut cargo = Command::new(toolchain::cargo());
        cargo.args(["build", "--locked", "--package", PROGRAM, "--profile", profile, "--target-dir"]).arg(&target);
        cargo.env("RUSTC_WRAPPER", this).env(TIMES, &times).current_dir(root);
        let meter = Meter::start();
        let status = cargo.status().map_err(|error| format!("cargo cannot be started: {error}"))?;
        let whole = meter.cost();
        if !status.success() {
            return Err("the program does not build, see above".into());
        }
        let program = target.join(profile).join(format!("{PROGRAM}{}", env::consts::EXE_SUFFIX));
        let size = fs::metadata(&program).map_err(|error| format!("{}: {error}", program.display()))?.len();
        let times = fs::read_to_string(&times).map_err(|error| format!("{}: {error}", times.display()))?;
        let parents = parents(&toolchain::tree(root, PROGRAM)?);
        let mut crates: Vec<Crate> = sum(&times)
            .into_iter()
            .map(|(name, seconds)| Crate { chain: chain(&name, &parents), name, seconds })
            .collect();
        crates.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        Ok(Report { whole, size, crates })
    }

    /// Returns whether the build stays within its budgets.
    fn held(self, report: &Report) -> bool {
        let within = |cost: std::time::Duration| cost.as_secs_f64() <= PROCESSOR_BUDGET_S;
        // Each profile has one budget. Where processor time is not measured it counts as held.
        if self.dist { report.size <= SIZE_BUDGET } else { report.whole.processor.is_none_or(within) }
    }

    fn print(self, report: &Report) {
        let of_compilers: f64 = report.crates.iter().map(|one| one.seconds).sum();
        let promised = match (self.dist, self.held(report)) {
            (true, true) => format!("promised: at most {} bytes", SIZE_BUDGET),
            (true, false) => format!("NOT HELD: at most {} bytes", SIZE_BUDGET),
            (false, true) => format!("promised: at most {PROCESSOR_BUDGET_S} s of processor time"),
            (false, false) => format!("NOT HELD: at most {PROCESSOR_BUDGET_S} s of processor time"),
        };
        println!("from an empty folder: {}; the program has {} bytes ({promised})", report.whole, report.size);
        println!("{} packages, {of_compilers:.1} s in their compilers; the slowest:\n", report.crates.len());
        println!("{:>11}  {:<20}  because of", "processor s", "package");
        for one in report.crates.iter().take(SLOWEST) {
            println!("{:>11.1}  {:<20}  {}", one.seconds, one.name, one.chain.join(" > "));
        }
    }

    fn object(self, report: &Report) -> Value {
        let crates = report
            .crates
            .iter()
            .map(|one| json!({"package": one.name, "processor_s": one.seconds, "chain": one.chain}));
        json!({
            "profile": if self.dist { "dist" } else { "release" },
            "wall_s": report.whole.wall.as_secs_f64(),
            "processor_s": report.whole.processor.map(|time| time.as_secs_f64()),
            "program_bytes": report.size,
            "packages": crates.collect::<Vec<_>>(),
            "held": self.held(report),
        })
    }
}

/// Runs the compiler that cargo asks this program for, and records its cost; `None` where the program was not called as
/// a compiler.
pub(crate) fn compiler() -> Option<ExitCode> {
    let times = PathBuf::from(env::var_os(TIMES)?);
    let mut words = env::args_os().skip(1);
    let compiler = words.next()?;
    let meter = Meter::start();
    let status = Command::new(compiler).args(words).status();
    let cost = meter.cost().processor.unwrap_or_default();
    // Cargo sets the name of the package. One short line is one write, so that lines of parallel compilers do not mix.
    if let Ok(package) = env::var("CARGO_PKG_NAME") {
        let line = format!("{package} {}\n", cost.as_secs_f64());
        let file = fs::File::options().append(true).create(true).open(&times);
        if file.and_then(|mut file| file.write_all(line.as_bytes())).is_err() {
            eprintln!("{} cannot be written to: {package} is not weighed", times.display());
        }
    }
    let code = status.ok().and_then(|status| status.code()).and_then(|code| u8::try_from(code).ok());
    Some(code.map_or(ExitCode::FAILURE, ExitCode::from))
}

/// Adds up the times of each package, from lines like `rustix 3.25`.
fn sum(times: &str) -> BTreeMap<String, f64> {
    let mut sums = BTreeMap::new();
    for (name, seconds) in times.lines().filter_map(|line| line.split_once(' ')) {
        *sums.entry(name.to_owned()).or_default() += seconds.parse().unwrap_or(0.0);
    }
    sums
}

/// Returns for each package the one that needs it on the shortest path from the program.
fn parents(tree: &[Node]) -> BTreeMap<String, String> {
    // Cargo prints a tree by depth: the parent of a line is the last one above it with a lower depth.
    let mut edges: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    let mut path: Vec<&str> = Vec::new();
    for Node { depth, name, .. } in tree {
        path.truncate(*depth);
        if let Some(parent) = path.last() {
            edges.entry(parent).or_default().push(name);
        }
        path.push(name);
    }
    let mut parents = BTreeMap::new();
    // Breadth first: the first parent found is on a shortest path.
    let mut next = VecDeque::from([PROGRAM]);
    while let Some(parent) = next.pop_front() {
        for &child in edges.get(parent).into_iter().flatten() {
            if child != PROGRAM && !parents.contains_key(child) {
                parents.insert(child.to_owned(), parent.to_owned());
                next.push_back(child);
            }
        }
    }
    parents
}

fn chain(name: &str, parents: &BTreeMap<String, String>) -> Vec<String> {
    let mut chain = vec![name.to_owned()];
    while let Some(parent) = chain.last().and_then(|last| parents.get(last)) {
        chain.push(parent.clone());
    }
    chain.reverse();
    chain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_understood() {
        assert_eq!(Weight::parse(&[]), Ok(Weight::default()));
        assert_eq!(Weight::parse(&["--json", "--dist"]), Ok(Weight { dist: true, json: true }));
        assert!(Weight::parse(&["--fast"]).expect_err("no word").contains("--fast"));
    }

    #[test]
    fn the_parts_of_a_package_are_added_up() {
        let sums = sum("rustix 3.25\nlibm 1\nrustix 0.5\n");
        assert_eq!(sums, BTreeMap::from([("libm".into(), 1.0), ("rustix".into(), 3.75)]));
    }

    #[test]
    fn a_package_is_there_because_of_the_shortest_way_to_it() {
        let tree = "0r4 v0.1.0 (/r/host/cli)\n1r4-log v0.1.0\n2mcap v0.26.0\n3syn v2.0.119 (proc-macro)\n1clap v4\n2syn v2.0.119\n";
        let tree: Vec<Node> = tree.lines().filter_map(Node::read).collect();
        let parents = parents(&tree);
        assert_eq!(chain("syn", &parents), ["r4", "clap", "syn"]);
        assert_eq!(chain("mcap", &parents), ["r4", "r4-log", "mcap"]);
        assert_eq!(chain("r4", &parents), ["r4"]);
    }

    #[test]
    fn promises_are_those_of_what_was_built() {
        let report = |seconds, size| Report {
            whole: Cost { processor: Some(std::time::Duration::from_secs(seconds)), ..Cost::default() },
            size,
            crates: Vec::new(),
        };
        let (release, dist) = (Weight::default(), Weight { dist: true, json: false });
        assert!(release.held(&report(400, 50_000_000)) && !release.held(&report(401, 1)));
        assert!(dist.held(&report(2_000, 15_000_000)) && !dist.held(&report(1, 15_000_001)));
    }
}
