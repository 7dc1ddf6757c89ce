//! What a message is made of: the primitive types, arrays and nested structures that CDR can carry as they are.

/// One field of a message, as declared.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// The field's name in Rust, in the ROS 2 definition and in Python.
    pub name: &'static str,
    /// Bytes from the start of the message.
    pub offset: usize,
    /// The element's type in ROS 2 spelling, such as `float32` or `mirror_msgs/Header`.
    pub element: &'static str,
    /// Element count for an array (of all dimensions, which ROS 2 wants flat), `None` for a single value.
    pub count: Option<usize>,
    /// Definition of a nested structure's own fields, if it is one.
    pub nested: Option<fn() -> &'static [Field]>,
    /// Bytes that the whole field takes.
    pub size: usize,
    /// The alignment that CDR asks of the field's first byte.
    pub align: usize,
    /// Whether the field's bytes are zero-padded UTF-8: in a recording, a ROS 2 `string`.
    pub is_text: bool,
    /// The field's documentation, a line of it a line.
    pub doc: &'static str,
}

/// A type that may stand in a message.
pub trait FieldType: Copy {
    /// The element's name in a ROS 2 definition.
    const ROS: &'static str;
    /// Element count for an array.
    const COUNT: Option<usize> = None;
    /// The fields of a nested structure.
    const NESTED: Option<fn() -> &'static [Field]> = None;
    /// All zeros, the state of a message that nobody filled in.
    const ZERO: Self;
}

macro_rules! primitive {
    ($($rust:ty => $ros:literal, $zero:literal;)*) => {
        $(impl FieldType for $rust {
            const ROS: &'static str = $ros;
            const ZERO: Self = $zero;
        })*
    };
}

primitive! {
    u8 => "uint8", 0;
    i32 => "int32", 0;
    u32 => "uint32", 0;
    u64 => "uint64", 0;
    f32 => "float32", 0.0;
    f64 => "float64", 0.0;
}

impl<T: FieldType, const N: usize> FieldType for [T; N] {
    const ROS: &'static str = T::ROS;
    const COUNT: Option<usize> = Some(match T::COUNT {
        Some(inner) => inner * N,
        None => N,
    });
    const NESTED: Option<fn() -> &'static [Field]> = T::NESTED;
    const ZERO: Self = [T::ZERO; N];
}

/// What a text field is called in a definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Text {
    /// The bytes that it has in memory.
    Bytes,
    /// A `string`.
    String,
}

/// A nested structure's ROS 2 type, and its fields.
type Nested = (&'static str, fn() -> &'static [Field]);

/// Writes the ROS 2 definition of `fields`, and after it those of the structures nested in them.
pub(crate) fn write_definition(fields: &[Field], text: Text, out: &mut String) {
    let mut nested: Vec<Nested> = Vec::new();
    write_fields(fields, text, out, &mut nested);
    let mut next = 0;
    while next < nested.len() {
        let (name, inner) = nested[next];
        out.push_str(&"=".repeat(80));
        out.push_str(&format!("\nMSG: {name}\n"));
        write_fields(inner(), text, out, &mut nested);
        next += 1;
    }
}

/// A field's line in a definition.
pub(crate) fn line(field: &Field, text: Text) -> String {
    let Field { element, name, .. } = field;
    match field.count {
        _ if field.is_text && text == Text::String => format!("string {name}\n"),
        Some(count) => format!("{element}[{count}] {name}\n"),
        None => format!("{element} {name}\n"),
    }
}

fn write_fields(fields: &[Field], text: Text, out: &mut String, nested: &mut Vec<Nested>) {
    for field in fields {
        out.push_str(&line(field, text));
        if let Some(inner) = field.nested
            && !nested.iter().any(|(name, _)| *name == field.element)
        {
            nested.push((field.element, inner));
        }
    }
}
