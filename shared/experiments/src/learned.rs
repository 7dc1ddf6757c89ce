//! Human models of one person, learned from their rounds: implants or policies, whatever the kind takes.

use models::{HumanModel, Kind, SelfHuman, SelfModel};
use std::sync::Arc;
use training::demonstrations::Demonstrations;
pub use training::policies::Expert;
use training::{config, implants, policies};

/// Learns a human model of `kind`.
///
/// # Errors
/// If the rounds are too short to learn from, or do not say what a kind has to be told.
pub fn human_model(
    kind: Kind,
    model: &Arc<SelfModel>,
    demonstrations: &Demonstrations,
    expert: &Expert,
) -> anyhow::Result<Box<dyn HumanModel>> {
    match kind {
        Kind::Myself => Ok(Box::new(SelfHuman::new(model.clone(), None, 0))),
        Kind::Mirror | Kind::MirrorP => {
            let settings = implants::Settings::default();
            let learned = implants::learn(model, kind, demonstrations, &settings, |_, _| {})?;
            Ok(Box::new(SelfHuman::new(
                model.clone(),
                Some(learned.implants),
                0,
            )))
        }
        Kind::Ideal => {
            anyhow::bail!("human model `ideal`: of a driver on the highway there is none")
        }
        Kind::Bc | Kind::Sqil => {
            let learned = policies::learn(
                kind,
                demonstrations,
                expert,
                config::highway(),
                0,
                &|_, _, _| {},
            )?;
            Ok(Box::new(learned.person.human(kind, &model.layout)))
        }
    }
}
