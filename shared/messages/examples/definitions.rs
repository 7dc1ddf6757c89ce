//! Prints the ROS 2 definition and layout of every message, as `tests/definitions.txt` keeps them.

fn main() {
    print!("{}", messages::all_definitions());
}
