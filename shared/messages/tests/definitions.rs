//! The messages' promises: definitions do not change unnoticed, and memory is CDR.

use messages::{Field, LidarFrame, Message, layout_hash};

#[test]
fn definitions_are_those_on_record() {
    let recorded = include_str!("definitions.txt");
    let current = messages::all_definitions();
    for (line, (recorded, current)) in recorded.lines().zip(current.lines()).enumerate() {
        assert_eq!(
            recorded,
            current,
            "definitions.txt:{}: a message changed. Raise its version, then write the file anew: \
             cargo run -p messages --example definitions > shared/messages/tests/definitions.txt",
            line + 1
        );
    }
    assert_eq!(
        recorded.len(),
        current.len(),
        "a message was added or removed"
    );
}

#[test]
fn python_structures_are_those_that_the_types_make() {
    let file = include_str!("../../../examples/python/mirror_messages.py");
    let current = messages::python_module();
    for (line, (recorded, current)) in file.lines().zip(current.lines()).enumerate() {
        assert_eq!(
            recorded,
            current,
            "mirror_messages.py:{}: a message changed. Write the file anew: \
             cargo run -p messages --example python_layouts > examples/python/mirror_messages.py",
            line + 1
        );
    }
    assert_eq!(file.len(), current.len(), "a message was added or removed");
    for (topic, class) in [("world/lidar", "LidarFrame"), ("run/report", "Report")] {
        let line = format!("    \"{topic}\": {class},\n");
        assert!(file.contains(&line), "{topic}");
    }
    let phases = "\n    START = 0\n    PERCEIVE = 1\n    FORGET = 2\n    COMPARE = 3\n";
    assert!(file.contains(phases), "{phases}");
    let layout = format!("    LAYOUT = \"{}\"\n", LidarFrame::layout_text());
    assert!(file.contains(&layout), "{layout}");
}

/// Whoever reads a message in another language has the numbers' meanings from the fields' documentation.
#[test]
fn numbers_have_one_meaning_in_either_direction() {
    use messages::{ControlCommand, ImaginePhase, ProcessState, UnknownNumber};
    for numbers in messages::NUMBERS {
        let mut seen = std::collections::BTreeSet::new();
        for (name, number) in numbers.values {
            assert!(seen.insert(number), "{}::{name}", numbers.name);
        }
        let mut documented = false;
        messages::for_each_message(|message| {
            let mut docs = message.fields.iter().map(|field| field.doc);
            documented |= docs.any(|doc| doc.contains(numbers.name));
        });
        assert!(documented, "{}: no field says that it is one", numbers.name);
    }
    for number in 0..=9 {
        match ProcessState::from_wire(number) {
            Ok(state) => assert_eq!(state.wire(), number),
            Err(error) => {
                let what = "ProcessState";
                assert_eq!(error, UnknownNumber { what, number });
                assert!([0, 9].contains(&number), "{error}");
            }
        }
    }
    assert_eq!(ControlCommand::try_from(6), Ok(ControlCommand::HandOver));
    assert_eq!(u32::from(ImaginePhase::Compare), 3);
}

/// Bytes of a CDR primitive.
fn primitive(element: &str) -> usize {
    match element {
        "uint8" => 1,
        "int32" | "uint32" | "float32" => 4,
        "uint64" | "float64" => 8,
        other => panic!("{other} is no primitive that CDR knows"),
    }
}

/// Walks `fields` as a CDR writer does, from `position` on, and asserts that it pads nowhere and that every field lies
/// where memory has it.
fn walk(name: &str, fields: &[Field], start: usize) -> usize {
    let mut position = start;
    for field in fields {
        assert_eq!(
            position - start,
            field.offset,
            "{name}.{}: memory and CDR differ",
            field.name
        );
        for _ in 0..field.count.unwrap_or(1) {
            match field.nested {
                Some(inner) => position = walk(field.element, inner(), position),
                None => {
                    let size = primitive(field.element);
                    assert_eq!(
                        position % size,
                        0,
                        "{name}.{}: CDR would pad before it",
                        field.name
                    );
                    position += size;
                }
            }
        }
        assert_eq!(
            position - start,
            field.offset + field.size,
            "{name}.{}: size",
            field.name
        );
    }
    position
}

#[test]
fn memory_is_the_cdr_body() {
    let mut checked = 0;
    messages::for_each_message(|message| {
        assert_eq!(
            walk(message.type_name, message.fields, 0),
            message.size,
            "{}",
            message.type_name
        );
        checked += 1;
    });
    assert!(checked >= 15, "only {checked} messages were checked");
}

#[test]
fn layouts_tell_apart_what_names_and_sizes_do_not() {
    let mut layouts = std::collections::BTreeMap::new();
    messages::for_each_message(|message| {
        assert!(
            message.type_name.starts_with("mirror/"),
            "{}",
            message.type_name
        );
        if let Some(other) = layouts.insert(message.layout, message.type_name) {
            panic!("{other} and {} have one layout", message.type_name);
        }
    });
    let definition = LidarFrame::definition();
    let swapped = definition.replace(
        "int32[36] object\nfloat32[36] speed_mps",
        "float32[36] speed_mps\nint32[36] object",
    );
    assert_ne!(definition, swapped, "the definition has the two fields");
    let hash = |text: &str| layout_hash(&format!("{}\n{text}", LidarFrame::TYPE_NAME));
    assert_eq!(hash(&definition), LidarFrame::layout());
    assert_ne!(hash(&swapped), LidarFrame::layout());
}

#[test]
fn zero_is_all_zeros() {
    assert!(messages::Report::ZERO.bytes().iter().all(|byte| *byte == 0));
    assert!(
        messages::Display::ZERO
            .bytes()
            .iter()
            .all(|byte| *byte == 0)
    );
    assert_eq!(LidarFrame::ZERO.bytes().len(), size_of::<LidarFrame>());
}
