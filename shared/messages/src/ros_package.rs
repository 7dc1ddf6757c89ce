//! The messages as a ROS 2 interface package, for whoever wants to build against them: `package.xml`, `CMakeLists.txt`,
//! and a `.msg` file per message with its documentation.

use crate::field::{Text, line};
use crate::{Description, for_each_message};

/// Name of the package: what stands before the slash in [`Message::ROS_TYPE`](crate::Message::ROS_TYPE).
const NAME: &str = "mirror_msgs";
/// Most columns of a comment.
const COLUMNS: usize = 118;

/// The package's files: path inside its folder, and text. Text fields are `string`s, as in recordings.
pub fn ros_package() -> Vec<(String, String)> {
    let mut files = Vec::new();
    for_each_message(|message| {
        let name = message.ros_type.trim_start_matches(NAME);
        files.push((format!("msg{name}.msg"), interface(&message)));
    });
    let list: String = files
        .iter()
        .map(|(path, _)| format!("  \"{path}\"\n"))
        .collect();
    files.push(("CMakeLists.txt".to_owned(), cmake(&list)));
    files.push(("package.xml".to_owned(), manifest()));
    files
}

/// A message's `.msg` file.
fn interface(message: &Description) -> String {
    let mut out = String::new();
    comment(message.doc, &mut out);
    for field in message.fields {
        out.push('\n');
        comment(field.doc, &mut out);
        out.push_str(&line(field, Text::String));
    }
    out
}

/// Documentation as comments: links become their names, and lines are wrapped anew.
fn comment(doc: &str, out: &mut String) {
    let mut text = doc.replace("[`", "`").replace("`]", "`");
    while let Some((before, target)) = text.split_once("`(crate::") {
        let after = target.split_once(')').map_or("", |(_, after)| after);
        text = format!("{before}`{after}");
    }
    let mut columns = 0;
    for word in text.split_whitespace() {
        let width = word.chars().count() + 1;
        if columns == 0 || columns + width > COLUMNS {
            out.push_str(if columns == 0 { "#" } else { "\n#" });
            columns = 1;
        }
        out.push(' ');
        out.push_str(word);
        columns += width;
    }
    if columns > 0 {
        out.push('\n');
    }
}

fn cmake(interfaces: &str) -> String {
    format!(
        "cmake_minimum_required(VERSION 3.8)\n\
         project({NAME})\n\
         \n\
         find_package(ament_cmake REQUIRED)\n\
         find_package(rosidl_default_generators REQUIRED)\n\
         \n\
         rosidl_generate_interfaces(${{PROJECT_NAME}}\n\
         {interfaces})\n\
         \n\
         ament_export_dependencies(rosidl_default_runtime)\n\
         ament_package()\n"
    )
}

fn manifest() -> String {
    let version = env!("CARGO_PKG_VERSION");
    format!(
        "<?xml version=\"1.0\"?>\n\
         <?xml-model href=\"http://download.ros.org/schema/package_format3.xsd\" \
         schematypens=\"http://www.w3.org/2001/XMLSchema\"?>\n\
         <package format=\"3\">\n\
         \x20 <name>{NAME}</name>\n\
         \x20 <version>{version}</version>\n\
         \x20 <description>The messages that MIRROR's processes exchange, as its recordings hold them.</description>\n\
         \x20 <maintainer email=\"mirror@example.org\">The MIRROR developers</maintainer>\n\
         \x20 <license>MIT</license>\n\
         \x20 <license>Apache-2.0</license>\n\
         \n\
         \x20 <buildtool_depend>ament_cmake</buildtool_depend>\n\
         \x20 <build_depend>rosidl_default_generators</build_depend>\n\
         \x20 <exec_depend>rosidl_default_runtime</exec_depend>\n\
         \x20 <member_of_group>rosidl_interface_packages</member_of_group>\n\
         \n\
         \x20 <export>\n\
         \x20   <build_type>ament_cmake</build_type>\n\
         \x20 </export>\n\
         </package>\n"
    )
}
