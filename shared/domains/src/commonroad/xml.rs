//! Walking the XML tree with errors that name the file, the line and the element.

use super::error::CommonRoadError;
use super::scenario::Mark;
use roxmltree::{Document, Node};

/// No coordinate on Earth is farther from any projection's origin than this, in m.
const LARGEST_NUMBER: f64 = 1e8;

/// A document and the name that its errors carry.
pub(crate) struct Source<'a> {
    pub file: &'a str,
    pub document: &'a Document<'a>,
}

pub(crate) type Element<'a> = Node<'a, 'a>;

impl<'a> Source<'a> {
    /// An error at an element.
    pub fn error(&self, element: Element, problem: impl Into<String>) -> CommonRoadError {
        CommonRoadError::Element {
            file: self.file.to_owned(),
            line: self.line(element),
            element: element.tag_name().name().to_owned(),
            problem: problem.into(),
        }
    }

    /// Where an element stands.
    pub fn mark(&self, element: Element) -> Mark {
        Mark {
            line: self.line(element),
            element: element.tag_name().name().to_owned(),
        }
    }

    /// Line of an element's start, from 1.
    pub fn line(&self, element: Element) -> usize {
        self.document.text_pos_at(element.range().start).row as usize
    }

    /// The only child of this name; an error if there is none or a second one.
    pub fn child(&self, parent: Element<'a>, name: &str) -> Result<Element<'a>, CommonRoadError> {
        self.optional_child(parent, name)?
            .ok_or_else(|| self.error(parent, format!("<{name}> is missing")))
    }

    /// The only child of this name, if there is one; an error if there are two.
    pub fn optional_child(
        &self,
        parent: Element<'a>,
        name: &str,
    ) -> Result<Option<Element<'a>>, CommonRoadError> {
        let mut found = children(parent, name);
        let first = found.next();
        match found.next() {
            Some(second) => Err(self.error(
                second,
                format!("a second one in <{}>", parent.tag_name().name()),
            )),
            None => Ok(first),
        }
    }

    /// The element's text, without spaces around it.
    pub fn text(&self, element: Element<'a>) -> Result<&'a str, CommonRoadError> {
        match element.text().map(str::trim) {
            Some(text) if !text.is_empty() => Ok(text),
            _ => Err(self.error(element, "is empty")),
        }
    }

    /// The element's text as a finite number of believable size.
    pub fn number(&self, element: Element<'a>) -> Result<f64, CommonRoadError> {
        let text = self.text(element)?;
        let value: f64 = text
            .parse()
            .map_err(|_| self.error(element, format!("{} is not a number", shown(text))))?;
        if value.is_nan() || value.abs() > LARGEST_NUMBER {
            return Err(self.error(element, format!("{} is out of range", shown(text))));
        }
        Ok(value)
    }

    /// Number of the child `name`.
    pub fn number_in(&self, parent: Element<'a>, name: &str) -> Result<f64, CommonRoadError> {
        self.number(self.child(parent, name)?)
    }

    /// Number of the child `name`, which has to be between 0 (excluded) and `limit`.
    pub fn size_in(
        &self,
        parent: Element<'a>,
        name: &str,
        limit: f64,
    ) -> Result<f64, CommonRoadError> {
        let element = self.child(parent, name)?;
        let value = self.number(element)?;
        if value > 0.0 && value <= limit {
            Ok(value)
        } else {
            Err(self.error(element, format!("{value} is not between 0 and {limit}")))
        }
    }

    /// `exact`, or `intervalStart` and `intervalEnd`, as an interval.
    pub fn interval(&self, element: Element<'a>) -> Result<[f64; 2], CommonRoadError> {
        if let Some(exact) = self.optional_child(element, "exact")? {
            let value = self.number(exact)?;
            return Ok([value, value]);
        }
        let from = self.number_in(element, "intervalStart")?;
        let to = self.number_in(element, "intervalEnd")?;
        if from > to {
            return Err(self.error(
                element,
                format!("the interval from {from} to {to} is empty"),
            ));
        }
        Ok([from, to])
    }

    /// Time in steps, exact or as an interval.
    pub fn steps(&self, element: Element<'a>) -> Result<[u32; 2], CommonRoadError> {
        let [from, to] = self.interval(element)?;
        let whole = |value: f64| {
            // A million steps are a day at 0.1 s.
            if value.fract() == 0.0 && (0.0..=1e6).contains(&value) {
                Ok(value as u32)
            } else {
                Err(self.error(
                    element,
                    format!("{value} is not a time step between 0 and 1000000"),
                ))
            }
        };
        Ok([whole(from)?, whole(to)?])
    }

    /// An attribute.
    pub fn attribute(&self, element: Element<'a>, name: &str) -> Result<&'a str, CommonRoadError> {
        element
            .attribute(name)
            .map(str::trim)
            .ok_or_else(|| self.error(element, format!("attribute {name:?} is missing")))
    }

    /// A whole number in an attribute.
    pub fn identity(&self, element: Element<'a>, name: &str) -> Result<i64, CommonRoadError> {
        let text = self.attribute(element, name)?;
        text.parse().map_err(|_| {
            self.error(
                element,
                format!("{name} {} is not a whole number", shown(text)),
            )
        })
    }

    /// `x` and `y`; `z` is ignored.
    pub fn point(&self, element: Element<'a>) -> Result<[f64; 2], CommonRoadError> {
        Ok([self.number_in(element, "x")?, self.number_in(element, "y")?])
    }
}

/// Child elements of this name.
pub(crate) fn children<'a>(parent: Element<'a>, name: &str) -> impl Iterator<Item = Element<'a>> {
    parent
        .children()
        .filter(move |node| node.is_element() && node.tag_name().name() == name)
}

/// Text for a message: quoted, and cut where it is long.
pub(crate) fn shown(text: &str) -> String {
    let cut: String = text.chars().take(40).collect();
    if cut.len() < text.len() {
        format!("{cut:?}…")
    } else {
        format!("{cut:?}")
    }
}
