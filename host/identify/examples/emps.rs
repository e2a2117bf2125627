use r4_identify::{data::*, family::*, fit, motion::*, select};
use std::collections::BTreeMap;
fn read(path: &str, input: &str, output: &str) -> Run {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let heads = reader.headers().unwrap().clone();
    let at = |name: &str| heads.iter().position(|head| head == name).unwrap();
    let (t, i, o) = (at("t_s"), at(input), at(output));
    let mut run = Run { name: path.into(), time_s: vec![], signals: BTreeMap::new() };
    let (mut a, mut b) = (vec![], vec![]);
    for row in reader.records() {
        let row = row.unwrap();
        run.time_s.push(row[t].parse().unwrap());
        a.push(row[i].parse().unwrap());
        b.push(row[o].parse().unwrap());
    }
    run.signals.insert("input".into(), Signal { column: input.into(), quantity: Quantity::Voltage, values: a });
    run.signals.insert("output".into(), Signal { column: output.into(), quantity: Quantity::Length, values: b });
    run
}
fn main() {
    let d = "/work/shared/data/emps/";
    let train = read(&format!("{d}train_trajectory.csv"), "u_V", "q_meas_m");
    let test = read(&format!("{d}test_trajectory_with_pulses.csv"), "u_V", "q_meas_m");
    let known = Known { gain: Some(35.15065188), ..Known::default() };
    let (model, train, test) = Motion::new(Kind::Axis, &known, &[train], &[test]).unwrap();
    let start = std::time::Instant::now();
    let found = select::search(&model, &train, &|step| eprintln!("{:6.1} {step}", start.elapsed().as_secs_f64()));
    let show = |fit: &fit::Fit| {
        let r = fit.residuals(&model, &[&train[0]]);
        let rms = |r: &Vec<f64>| (r.iter().map(|x| x * x).sum::<f64>() / r.len() as f64).sqrt();
        let initial = fit::settle(&model, &fit.structure, &test[0], 2000);
        let h = fit::residuals(&model, &fit.structure, &initial, &test[0]);
        println!("train {:.3} mm test {:.3} mm", 1e3 * rms(&r[0]), 1e3 * rms(&h));
    };
    show(&found.base);
    for step in &found.steps {
        show(&step.fit);
        println!("{:?} {:?}", step.fit.structure.base, step.fit.structure.added);
        println!(
            "{:?} blocked {:?} p {:.1e} better {:?} z {:.1} rivals {:?}",
            match &step.term {
                Term::Known(i) => model.catalogue()[*i].name.to_string(),
                Term::Curve(c) => format!("{:?}", c.over),
            },
            step.blocked_rmse,
            step.p_value,
            step.blocks_better,
            step.z,
            step.rivals.iter().map(|(i, e)| (model.catalogue()[*i].name, *e)).collect::<Vec<_>>()
        );
    }
    show(&found.last);
    for (p, (v, d)) in fit::parameters(&model, &found.last.structure.terms)
        .iter()
        .zip(found.last.structure.base.iter().chain(found.last.structure.added.iter().flatten()).zip(&found.deviations))
    {
        println!("{} {} {:?}", p.name, v, d);
    }
    println!("{:#?}", found.rejected);
}
