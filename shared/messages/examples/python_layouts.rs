//! Prints every message as a Python structure, as `examples/python/mirror_messages.py` keeps them.

fn main() {
    print!("{}", messages::python_module());
}
