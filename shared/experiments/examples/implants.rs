//! Learnt implants against the truth: `implants SELF_MODEL OUT PEOPLE`.

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, model, out, people] = arguments.as_slice() else {
        anyhow::bail!("usage: implants SELF_MODEL OUT PEOPLE");
    };
    std::fs::create_dir_all(out)?;
    let model = models::checkpoint::load_self_model(model.as_ref())?;
    let settings = training::implants::Settings::default();
    let mut reports = Vec::new();
    for id in 1..=people.parse()? {
        let report = experiments::implants::report(&model, id, 6, true, &settings)?;
        println!(
            "person {id}: {:.1} s, loss {:.3} → {:.3}, error where present {:.2} m (middle {:.2}), all {:.2} m",
            report.seconds,
            report.loss[0],
            report.loss[1],
            report.error_present_m,
            report.error_of_middle_m,
            report.error_m
        );
        reports.push(report);
    }
    experiments::implants::write_csv(&reports, out.as_ref())?;
    experiments::implants::draw(&reports, out.as_ref())
}
