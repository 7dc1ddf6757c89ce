//! The messages as Python's `ctypes` structures, for processes written in Python: one module, generated, that checks
//! itself when it is imported.

use crate::*;
use std::fmt::Write;

/// Text of a Python module with every message, every topic and the sizes that their arrays have. A structure's
/// `type_name()` is what iceoryx2 knows the message by, its `LAYOUT` what the service's attribute must say.
pub fn python_module() -> String {
    let mut out = String::from(
        "\"\"\"The messages of a MIRROR process set, byte for byte as the Rust processes lay them out in shared memory.\n\
         \n\
         Generated from the Rust types, whose documentation says what each field means; do not edit. To write it anew:\n\
         \n\
         \x20   cargo run -p messages --example python_layouts > examples/python/mirror_messages.py\n\
         \"\"\"\n\
         \n\
         import ctypes\n\
         from enum import IntEnum\n\
         \n",
    );
    for (name, value) in [
        ("AZIMUTHS", AZIMUTHS),
        ("HEIGHT_BANDS", HEIGHT_BANDS),
        ("BEAMS", BEAMS),
        ("EGO_VALUES", EGO_VALUES),
        ("SECTORS", SECTORS),
        ("VERBAL", VERBAL),
        ("LATENT", LATENT),
        ("ACTIONS", ACTIONS),
        ("CHOICES", CHOICES),
        ("VISUAL_NUMBERS", VISUAL_NUMBERS),
        ("VERBAL_NUMBERS", VERBAL_NUMBERS),
        ("VISUAL_ITEMS", VISUAL_ITEMS),
        ("VERBAL_ITEMS", VERBAL_ITEMS),
        ("MAX_OBJECTS", MAX_OBJECTS),
        ("MAX_GROUP", MAX_GROUP),
    ] {
        line(&mut out, format_args!("{name} = {value}"));
    }
    out.push_str("\n#: `Control.process` that addresses everybody.\n");
    line(&mut out, format_args!("EVERYBODY = {}", Control::EVERYBODY));
    for numbers in NUMBERS {
        write_enum(numbers, &mut out);
    }
    for_each_message(|message| write_structure(&message, &mut out));
    out.push_str("\n\n#: The message that travels on each topic.\nTOPICS = {\n");
    for_each_topic(|topic, message| {
        let class = class_name(message.ros_type);
        line(&mut out, format_args!("    \"{topic}\": {class},"));
    });
    out.push_str(
        "}\n\n#: Of every message: its bytes, and where each of its fields begins.\n_PLACES = {\n",
    );
    for_each_message(|message| {
        let class = class_name(message.ros_type);
        let offsets: Vec<_> = message
            .fields
            .iter()
            .map(|f| f.offset.to_string())
            .collect();
        let (size, offsets) = (message.size, offsets.join(", "));
        line(
            &mut out,
            format_args!("    {class}: ({size}, [{offsets}]),"),
        );
    });
    out.push_str(
        "}\n\
         \n\
         for _structure, (_size, _offsets) in _PLACES.items():\n\
         \x20   assert ctypes.sizeof(_structure) == _size, _structure\n\
         \x20   assert [getattr(_structure, f[0]).offset for f in _structure._fields_] == _offsets, _structure\n",
    );
    out
}

fn line(out: &mut String, text: core::fmt::Arguments) {
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{text}");
}

/// `Header` of `mirror_msgs/Header`.
fn class_name(ros_type: &str) -> &str {
    ros_type.rsplit('/').next().unwrap_or(ros_type)
}

fn write_enum(numbers: &Numbers, out: &mut String) {
    line(out, format_args!("\n\nclass {}(IntEnum):", numbers.name));
    let doc = numbers.doc.trim();
    line(out, format_args!("    \"\"\"{doc}\"\"\"\n"));
    for (name, number) in numbers.values {
        line(out, format_args!("    {} = {number}", constant(name)));
    }
}

/// `OUT_OF_TIME` of `OutOfTime`.
fn constant(name: &str) -> String {
    let mut out = String::new();
    for (place, letter) in name.chars().enumerate() {
        if place > 0 && letter.is_uppercase() {
            out.push('_');
        }
        out.push(letter.to_ascii_uppercase());
    }
    out
}

fn write_structure(message: &Description, out: &mut String) {
    let (class, type_name) = (class_name(message.ros_type), message.type_name);
    line(out, format_args!("\n\nclass {class}(ctypes.Structure):"));
    line(
        out,
        format_args!("    LAYOUT = \"{}\"", message.layout_text()),
    );
    out.push_str("    _fields_ = [\n");
    for field in message.fields {
        let element = match field.element {
            "uint8" => "ctypes.c_uint8",
            "int32" => "ctypes.c_int32",
            "uint32" => "ctypes.c_uint32",
            "uint64" => "ctypes.c_uint64",
            "float32" => "ctypes.c_float",
            "float64" => "ctypes.c_double",
            nested => class_name(nested),
        };
        let (name, count) = (field.name, field.count);
        match count {
            Some(count) => line(
                out,
                format_args!("        (\"{name}\", {element} * {count}),"),
            ),
            None => line(out, format_args!("        (\"{name}\", {element}),")),
        }
    }
    line(
        out,
        format_args!(
            "    ]\n\n    @staticmethod\n    def type_name() -> str:\n        return \"{type_name}\""
        ),
    );
}
