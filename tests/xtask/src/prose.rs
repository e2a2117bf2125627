//! Task `cargo xtask prose`: counts that show how readable the comments and pages are.
//!
//! Counts replace no reader. They show where one is needed, and keep an improvement from being lost.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use serde_json::json;

/// A doc comment of at most this many words says no more than the item's name.
const FRAGMENT_WORDS: usize = 3;
/// First words of a doc comment that hide the noun which a reader looks for.
const NOUNLESS: [&str; 9] = ["what", "whether", "of", "by", "how", "where", "when", "who", "whose"];
/// Page with the table of words that are not used.
const GLOSSARY: &str = "docs/glossary.md";
/// Heading of that table.
const TABLE: &str = "| not | but |";
/// Files that are listed with the most findings.
const WORST: usize = 15;
/// Largest share of fragments among doc comments, %.
const FRAGMENTS_PERCENT: f64 = 2.0;
/// Largest share of doc comments without a noun in front, %.
const NOUNLESS_PERCENT: f64 = 2.0;
/// Least share of comments among lines inside function bodies, %. It was 3.2 % when counting began.
const BODY_COMMENTS_PERCENT: f64 = 3.9;

/// Options of `cargo xtask prose`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Prose {
    json: bool,
    check: bool,
}

/// Counts over all files.
#[derive(Debug, Default, PartialEq)]
struct Counts {
    /// Doc comments: one item's, or one file's.
    docs: usize,
    /// Doc comments of at most [`FRAGMENT_WORDS`] words.
    fragments: usize,
    /// Doc comments that begin with one of [`NOUNLESS`].
    nounless: usize,
    /// Lines inside function bodies that are not blank.
    body_lines: usize,
    /// Those of [`Self::body_lines`] that are comments.
    body_comments: usize,
    /// Occurrences of each word that is not used.
    idioms: BTreeMap<String, usize>,
    /// Fragments, comments without a noun and idioms by file.
    files: BTreeMap<PathBuf, usize>,
}

impl Prose {
    /// Reads the words after `prose`.
    ///
    /// # Errors
    /// The first word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut prose = Self::default();
        for word in words {
            match *word {
                "--json" => prose.json = true,
                "--check" => prose.check = true,
                other => return Err(format!("`prose` takes no `{other}`")),
            }
        }
        Ok(prose)
    }

    /// Counts, and prints the result.
    pub(crate) fn run(self, root: &Path) -> ExitCode {
        let counts = match count(root) {
            Ok(counts) => counts,
            Err(problem) => {
                eprintln!("error: {problem}");
                return ExitCode::FAILURE;
            }
        };
        if self.json {
            println!("{}", counts.json());
        } else {
            print!("{}", counts.text());
        }
        let problems = if self.check { counts.problems() } else { Vec::new() };
        for problem in &problems {
            eprintln!("error: {problem}");
        }
        if problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }
}

/// Compares the counts with their limits.
///
/// # Errors
/// Every limit that is exceeded, a line each.
pub(crate) fn check(root: &Path) -> Result<(), String> {
    let problems = count(root)?.problems();
    if problems.is_empty() { Ok(()) } else { Err(problems.join("\n") + "\n`cargo xtask prose` lists the files") }
}

impl Counts {
    /// Returns what exceeds its limit, a sentence each.
    fn problems(&self) -> Vec<String> {
        let fragments = percent(self.fragments, self.docs);
        let nounless = percent(self.nounless, self.docs);
        let comments = percent(self.body_comments, self.body_lines);
        let words: usize = self.idioms.values().sum();
        let mut problems = Vec::new();
        if fragments > FRAGMENTS_PERCENT {
            problems.push(format!(
                "{fragments:.1} % of doc comments have at most {FRAGMENT_WORDS} words; limit {FRAGMENTS_PERCENT} %"
            ));
        }
        if nounless > NOUNLESS_PERCENT {
            problems.push(format!("{nounless:.1} % of doc comments begin without a noun; limit {NOUNLESS_PERCENT} %"));
        }
        if comments < BODY_COMMENTS_PERCENT {
            problems.push(format!(
                "{comments:.1} % of the lines inside functions are comments; at least {BODY_COMMENTS_PERCENT} %"
            ));
        }
        if words > 0 {
            problems.push(format!("{words} occurrences of words that {GLOSSARY} says to avoid; limit 0"));
        }
        problems
    }

    fn json(&self) -> serde_json::Value {
        json!({
            "doc_comments": self.docs,
            "fragments": self.fragments,
            "nounless": self.nounless,
            "body_lines": self.body_lines,
            "body_comments": self.body_comments,
            "idioms": self.idioms,
        })
    }

    fn text(&self) -> String {
        let mut text = format!(
            "doc comments                      {:>6}\n\
             of at most {FRAGMENT_WORDS} words                {:>6}  {:.1} %, at most {FRAGMENTS_PERCENT} %\n\
             that begin without a noun         {:>6}  {:.1} %, at most {NOUNLESS_PERCENT} %\n\
             lines inside of functions         {:>6}\n\
             of which comments                 {:>6}  {:.1} %, at least {BODY_COMMENTS_PERCENT} %\n\
             words of {GLOSSARY} not to use {:>4}\n",
            self.docs,
            self.fragments,
            percent(self.fragments, self.docs),
            self.nounless,
            percent(self.nounless, self.docs),
            self.body_lines,
            self.body_comments,
            percent(self.body_comments, self.body_lines),
            self.idioms.values().sum::<usize>(),
        );
        let mut idioms: Vec<_> = self.idioms.iter().filter(|(_, count)| **count > 0).collect();
        idioms.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
        for (idiom, count) in idioms {
            text += &format!("  {count:>5}  {idiom}\n");
        }
        let mut files: Vec<_> = self.files.iter().collect();
        files.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
        text += "files with the most to mend:\n";
        for (path, count) in files.into_iter().take(WORST) {
            text += &format!("  {count:>5}  {}\n", path.display());
        }
        text
    }

    /// Adds the comments of a Rust file to the counts.
    fn add_code(&mut self, path: &Path, code: &str, idioms: &[String]) {
        let mut found = 0;
        for doc in doc_comments(code) {
            self.docs += 1;
            let words: Vec<_> = doc.split_whitespace().collect();
            if words.len() <= FRAGMENT_WORDS {
                self.fragments += 1;
                found += 1;
            } else if words.first().is_some_and(|word| NOUNLESS.contains(&word.to_lowercase().as_str())) {
                self.nounless += 1;
                found += 1;
            }
        }
        let (lines, comments) = body_lines(code);
        self.body_lines += lines;
        self.body_comments += comments;
        let comments: String = code
            .lines()
            .filter_map(|line| line.split_once("//"))
            .map(|(_, comment)| comment.to_owned() + "\n")
            .collect();
        found += self.add_idioms(&comments, idioms);
        *self.files.entry(path.to_owned()).or_default() += found;
    }

    /// Adds the words of a page to the counts.
    fn add_page(&mut self, path: &Path, page: &str, idioms: &[String]) {
        let found = self.add_idioms(page, idioms);
        *self.files.entry(path.to_owned()).or_default() += found;
    }

    fn add_idioms(&mut self, text: &str, idioms: &[String]) -> usize {
        let text = text.to_lowercase();
        let mut found = 0;
        for idiom in idioms {
            let count = occurrences(&text, idiom);
            *self.idioms.entry(idiom.clone()).or_default() += count;
            found += count;
        }
        found
    }
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

fn count(root: &Path) -> Result<Counts, String> {
    let glossary = fs::read_to_string(root.join(GLOSSARY)).map_err(|error| format!("{GLOSSARY}: {error}"))?;
    let idioms = idioms(&glossary)?;
    let mut counts = Counts::default();
    for path in files(root)? {
        let Ok(text) = fs::read_to_string(root.join(&path)) else { continue };
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("rs") => counts.add_code(&path, &text, &idioms),
            Some("md") if path != Path::new(GLOSSARY) => counts.add_page(&path, &text, &idioms),
            _ => {}
        }
    }
    Ok(counts)
}

/// Lists the files of the repository, as git does.
fn files(root: &Path) -> Result<Vec<PathBuf>, String> {
    let output = Command::new("git")
        .args(["ls-files", "-z", "--", "*.rs", "*.md"])
        .current_dir(root)
        .output()
        .map_err(|error| format!("git cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("git ls-files: {}", String::from_utf8_lossy(&output.stderr).trim()));
    }
    Ok(String::from_utf8_lossy(&output.stdout).split_terminator('\0').map(PathBuf::from).collect())
}

/// Reads the first column of the table under [`TABLE`]: phrases separated by commas, without what is in brackets.
fn idioms(glossary: &str) -> Result<Vec<String>, String> {
    let (_, table) = glossary.split_once(TABLE).ok_or_else(|| format!("{GLOSSARY} has no table `{TABLE}`"))?;
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    Ok(rows
        .filter_map(|row| row.split('|').nth(1))
        .flat_map(|cell| cell.split(',').map(|phrase| phrase.trim().to_lowercase()).collect::<Vec<_>>())
        .filter(|phrase| !phrase.is_empty())
        .collect())
}

/// Counts occurrences of `phrase` in `text` that are no part of a longer word. Both are in lower case.
fn occurrences(text: &str, phrase: &str) -> usize {
    let is_letter = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    text.match_indices(phrase)
        .filter(|(at, _)| {
            !is_letter(text[..*at].chars().next_back()) && !is_letter(text[at + phrase.len()..].chars().next())
        })
        .count()
}

/// Returns the doc comments, each as one text: neighbouring lines of the same kind belong together.
fn doc_comments(code: &str) -> Vec<String> {
    let mut comments = Vec::new();
    let mut current: Option<(&str, String)> = None;
    for line in code.lines().map(str::trim_start) {
        let kind = ["///", "//!"].into_iter().find(|kind| line.starts_with(kind) && !line.starts_with("////"));
        match (kind, &mut current) {
            (Some(kind), Some((open, text))) if *open == kind => {
                text.push('\n');
                text.push_str(&line[kind.len()..]);
            }
            (kind, current) => {
                comments.extend(current.take().map(|(_, text)| text));
                *current = kind.map(|kind| (kind, line[kind.len()..].to_owned()));
            }
        }
    }
    comments.extend(current.map(|(_, text)| text));
    comments
}

/// Counts the lines inside of function bodies that are not blank, and those of them that are comments.
///
/// A body begins after the line of a `fn` that ends with its brace, and ends at a brace with the indentation of the
/// `fn`: that is true of all code that rustfmt has formatted.
fn body_lines(code: &str) -> (usize, usize) {
    let (mut lines, mut comments) = (0, 0);
    let mut signature: Option<usize> = None;
    let mut body: Option<usize> = None;
    for line in code.lines() {
        let trimmed = line.trim_start();
        let margin = line.len() - trimmed.len();
        if let Some(end) = body {
            if trimmed.starts_with('}') && margin == end {
                body = None;
            } else if !trimmed.is_empty() {
                lines += 1;
                comments += usize::from(trimmed.starts_with("//"));
            }
            continue;
        }
        if signature.is_none() && is_function(trimmed) {
            signature = Some(margin);
        }
        if let Some(margin) = signature {
            if trimmed.ends_with('{') {
                (signature, body) = (None, Some(margin));
            } else if trimmed.ends_with(';') || trimmed.ends_with('}') {
                signature = None;
            }
        }
    }
    (lines, comments)
}

/// Returns whether a line begins a function's signature.
fn is_function(line: &str) -> bool {
    const BEFORE: [&str; 8] = ["pub", "pub(crate)", "pub(super)", "pub(in", "const", "async", "unsafe", "extern"];
    line.split_whitespace().find(|word| !BEFORE.contains(word)) == Some("fn")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a Rust file, whose comments here begin with § so that they do not count as this file's own.
    fn code() -> String {
        "§! A file about\n§! two things.\n\n§/ Short.\nfn one() -> u8 {\n    § Because of the datasheet.\n    let a = 1;\n\n    a\n}\n\n\
        §/ What is not said with a noun first.\nconst B: u8 = 1;\nimpl A {\n    §/ Returns the value of B, in volts.\n    pub(crate) async fn two(\n        &self,\n    ) -> u8 {\n        B § for ever\n    }\n    fn three();\n}\n"
            .replace('§', "//")
    }

    #[test]
    fn a_comment_of_several_lines_is_one() {
        let comments = doc_comments(&code());
        assert_eq!(comments.len(), 4);
        assert_eq!(comments[0], " A file about\n two things.");
        assert_eq!(comments[3], " Returns the value of B, in volts.");
    }

    #[test]
    fn only_lines_of_bodies_count() {
        // Three lines of `one` and one of `two`, whose comment shares its line with code.
        assert_eq!(body_lines(&code()), (4, 1));
    }

    #[test]
    fn counts_are_of_comments_and_pages() {
        let idioms =
            idioms("# Words\n\n| not | but |\n| --- | --- |\n| for ever, befalls | until stopped |\n\nrest").unwrap();
        assert_eq!(idioms, ["for ever", "befalls"]);
        let mut counts = Counts::default();
        counts.add_code(Path::new("a.rs"), &code(), &idioms);
        counts.add_page(Path::new("a.md"), "For ever and whatever befalls it; not forever.", &idioms);
        assert_eq!((counts.docs, counts.fragments, counts.nounless), (4, 1, 1));
        assert_eq!(counts.idioms, BTreeMap::from([("befalls".into(), 1), ("for ever".into(), 2)]));
        assert_eq!(counts.files, BTreeMap::from([("a.rs".into(), 3), ("a.md".into(), 2)]));
    }

    #[test]
    fn limits_are_compared() {
        let good =
            Counts { docs: 100, fragments: 2, nounless: 2, body_lines: 100, body_comments: 4, ..Counts::default() };
        assert_eq!(good.problems(), Vec::<String>::new());
        let idioms = BTreeMap::from([("befalls".to_owned(), 1)]);
        let bad = Counts { docs: 100, fragments: 3, nounless: 3, body_lines: 100, body_comments: 3, idioms, ..good };
        assert_eq!(bad.problems().len(), 4);
    }

    #[test]
    fn a_part_of_a_word_is_no_occurrence() {
        assert_eq!(occurrences("the stairs, upstairs and stairs", "stairs"), 2);
    }
}
