//! Report of an identification on a terminal.

use std::path::PathBuf;

use r4_identify::report::{Report, Scores};

use crate::{
    output,
    report::{Scale, significant},
    table,
};

pub(super) fn print(report: &Report, files: &[PathBuf]) -> anyhow::Result<()> {
    let scale = Scale::of(&report.unit, report.last.holdout.rmse.max(report.last.train.rmse));
    output::line(&report.verdict)?;
    let unit = scale.unit();
    let mut scores =
        table::new(&["", &format!("fitted to ({unit})"), "NRMSE", &format!("held out ({unit})"), "NRMSE"], 1..5);
    let mut row = |name: &str, Scores { train, holdout }: &Scores| {
        let cells =
            [train, holdout].map(|score| [scale.text(score.rmse), format!("{} %", significant(100.0 * score.nrmse))]);
        scores.add_row([&[name.to_owned()], cells.as_flattened()].concat());
    };
    row("base model", &report.baseline);
    if !report.effects.is_empty() {
        row("with effects", &report.last);
    }
    output::line(scores)?;
    if !report.effects.is_empty() {
        let mut effects = table::new(&["effect", "depends on", "held out before", "after", "parameters"], 2..4);
        for effect in &report.effects {
            let parameters = effect.parameters.iter().map(|(name, estimate)| {
                let std = estimate.std.map_or(String::new(), |std| format!(" ± {}", significant(std)));
                let unit = if estimate.unit == "1" { String::new() } else { format!(" {}", estimate.unit) };
                format!("{name} {}{std}{unit}", significant(estimate.value))
            });
            effects.add_row([
                effect.name.clone(),
                effect.depends_on.join(", "),
                scale.text(effect.holdout_rmse_before),
                scale.text(effect.holdout_rmse_after),
                parameters.collect::<Vec<_>>().join("\n"),
            ]);
        }
        output::line(effects)?;
    }
    for (effect, rival) in
        report.effects.iter().flat_map(|effect| effect.rivals.iter().map(move |rival| (effect, rival)))
    {
        output::line(format_args!("{} or {}? To distinguish them: {}", effect.name, rival.name, rival.experiment))?;
    }
    for file in files {
        output::line(format_args!("wrote {}", file.display()))?;
    }
    Ok(())
}
