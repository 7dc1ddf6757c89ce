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

/// A nested structure's ROS 2 type, and its fields.
type Nested = (&'static str, fn() -> &'static [Field]);

/// Writes the ROS 2 definition of `fields`, and after it those of the structures nested in them.
pub(crate) fn write_definition(fields: &[Field], out: &mut String) {
    let mut nested: Vec<Nested> = Vec::new();
    write_fields(fields, out, &mut nested);
    let mut next = 0;
    while next < nested.len() {
        let (name, inner) = nested[next];
        out.push_str(&"=".repeat(80));
        out.push_str(&format!("\nMSG: {name}\n"));
        write_fields(inner(), out, &mut nested);
        next += 1;
    }
}

fn write_fields(fields: &[Field], out: &mut String, nested: &mut Vec<Nested>) {
    for field in fields {
        match field.count {
            Some(count) => out.push_str(&format!("{}[{count}] {}\n", field.element, field.name)),
            None => out.push_str(&format!("{} {}\n", field.element, field.name)),
        }
        if let Some(inner) = field.nested
            && !nested.iter().any(|(name, _)| *name == field.element)
        {
            nested.push((field.element, inner));
        }
    }
}
