//! Values that a shell offers when it completes a word, where any other text is taken too: a scene's name or a file,
//! for instance.

use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::error::Error;
use clap::{Arg, Command, ValueEnum};
use models::Kind;
use std::ffi::OsStr;

/// Takes any text, and names some that are known.
#[derive(Clone)]
pub struct Offered(fn() -> Vec<String>);

impl TypedValueParser for Offered {
    type Value = String;

    fn parse_ref(
        &self,
        command: &Command,
        argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, Error> {
        StringValueParser::new().parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new((self.0)().into_iter().map(PossibleValue::new)))
    }
}

fn owned<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    names.into_iter().map(str::to_owned).collect()
}

/// Scenes that ship.
pub fn scenes() -> Offered {
    Offered(|| owned(crate::place::shipped_scenes()))
}

/// Human models.
pub fn humans() -> Offered {
    Offered(|| owned(Kind::ALL.map(Kind::name)))
}

/// Human models that learn from a person's rounds.
pub fn learners() -> Offered {
    Offered(|| {
        let learn = Kind::ALL.into_iter().filter(|kind| kind.learns());
        owned(learn.map(Kind::name))
    })
}

/// Who may drive on the highway; a gridworld has the first ten.
pub fn drivers() -> Offered {
    Offered(|| {
        let people = 1..=domains::highway::Person::COUNT;
        let people = people.map(|id| format!("sim:{id}"));
        people.chain([crate::place::BROWSER.to_owned()]).collect()
    })
}

/// Simulated people of the highway, by number; a gridworld has the first ten.
pub fn people() -> Offered {
    Offered(|| {
        let people = 1..=domains::highway::Person::COUNT;
        people.map(|id| id.to_string()).collect()
    })
}

/// Processes of a set.
pub fn processes() -> Offered {
    Offered(|| owned(crate::process::NAMES))
}

/// What `mirror swap` can replace a process by.
pub fn kinds() -> Offered {
    Offered(|| {
        let planners = super::PlannerMethod::value_variants().iter();
        let planners = planners.map(|planner| planner.name());
        let humans = Kind::ALL.map(Kind::name);
        owned(humans.into_iter().chain(planners).chain(["same"]))
    })
}
