//! Page of an evaluation over seeds: tables, and a figure for each seed.

use std::fmt::Write as _;

use super::{Table, document, escaped, system::drawn, write_figure, write_table};

/// Page headed `title`, with `tables` above the `figures`, each with its heading.
pub(crate) fn evaluation(title: &str, tables: &[Table], figures: &[(String, r4_systems::Figure)]) -> String {
    let mut body = String::new();
    // Writing to a `String` cannot fail.
    let _ = write_body(&mut body, title, tables, figures);
    document(title, &body)
}

fn write_body(
    body: &mut String,
    title: &str,
    tables: &[Table],
    figures: &[(String, r4_systems::Figure)],
) -> std::fmt::Result {
    writeln!(body, "<header>\n<h1>{}</h1>\n</header>", escaped(title))?;
    for table in tables {
        write_table(body, table)?;
    }
    for (heading, figure) in figures {
        writeln!(body, "<section>\n<h2>{}</h2>\n<p>{}</p>", escaped(heading), escaped(&figure.description))?;
        write_figure(body, &drawn(figure))?;
        body.push_str("</section>\n");
    }
    Ok(())
}
