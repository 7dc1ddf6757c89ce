//! The standard ROS 2 types that Foxglove's 3D panel and rosbag tools know: values, and how they are written as CDR.

use crate::cdr::Cdr;

/// A standard type: its name and its definition with everything nested in it.
#[derive(Clone, Copy, Debug)]
pub struct Schema {
    /// Such as `sensor_msgs/msg/LaserScan`.
    pub name: &'static str,
    /// The `ros2msg` text.
    pub definition: &'static str,
}

/// `sensor_msgs/msg/LaserScan`.
pub const LASER_SCAN: Schema = Schema {
    name: "sensor_msgs/msg/LaserScan",
    definition: include_str!("definitions/LaserScan.msg"),
};
/// `visualization_msgs/msg/MarkerArray`.
pub const MARKER_ARRAY: Schema = Schema {
    name: "visualization_msgs/msg/MarkerArray",
    definition: include_str!("definitions/MarkerArray.msg"),
};
/// `tf2_msgs/msg/TFMessage`.
pub const TF_MESSAGE: Schema = Schema {
    name: "tf2_msgs/msg/TFMessage",
    definition: include_str!("definitions/TFMessage.msg"),
};

/// `rosgraph_msgs/msg/Clock`.
pub const CLOCK: Schema = Schema {
    name: "rosgraph_msgs/msg/Clock",
    definition: include_str!("definitions/Clock.msg"),
};

/// Writes a `builtin_interfaces/Time`.
fn write_time(time_ns: u64, cdr: &mut Cdr) {
    cdr.i32((time_ns / 1_000_000_000) as i32);
    cdr.u32((time_ns % 1_000_000_000) as u32);
}

/// Writes a whole `rosgraph_msgs/msg/Clock`.
pub fn write_clock(time_ns: u64, cdr: &mut Cdr) {
    cdr.start();
    write_time(time_ns, cdr);
}

/// `std_msgs/Header`.
#[derive(Clone, Copy, Debug)]
pub struct MarkerStamp {
    /// Nanoseconds since 1970, of the drive's time.
    pub time_ns: u64,
    /// Frame that the data stand in.
    pub frame: &'static str,
}

impl MarkerStamp {
    fn write(&self, cdr: &mut Cdr) {
        write_time(self.time_ns, cdr);
        cdr.string(self.frame);
    }
}

/// Position in metres and rotation about z: all that a car on a flat road needs of `geometry_msgs/Pose`.
#[derive(Clone, Copy, Debug, Default)]
pub struct MarkerPose {
    /// Position in metres.
    pub position: [f64; 3],
    /// Rotation about z in radians, anticlockwise.
    pub heading_rad: f64,
}

impl MarkerPose {
    /// Serves `geometry_msgs/Pose` and `geometry_msgs/Transform` alike, whose bytes are the same.
    fn write(&self, cdr: &mut Cdr) {
        let half = 0.5 * self.heading_rad;
        for value in self.position {
            cdr.f64(value);
        }
        for value in [0.0, 0.0, half.sin(), half.cos()] {
            cdr.f64(value);
        }
    }
}

/// One fan of beams, written as `sensor_msgs/msg/LaserScan`.
#[derive(Clone, Copy, Debug)]
pub struct LaserScan<'a> {
    /// When and in which frame.
    pub stamp: MarkerStamp,
    /// Radians from one beam to the next; the first looks straight ahead.
    pub increment_rad: f32,
    /// The longest range that the sensor measures.
    pub range_max_m: f32,
    /// One per beam, infinite where nothing was in range.
    pub ranges_m: &'a [f32],
    /// One per beam.
    pub intensities: &'a [f32],
}

impl LaserScan<'_> {
    /// Writes the whole message.
    pub fn write(&self, cdr: &mut Cdr) {
        cdr.start();
        self.stamp.write(cdr);
        cdr.f32(0.0);
        cdr.f32(self.increment_rad * (self.ranges_m.len() as f32 - 1.0));
        cdr.f32(self.increment_rad);
        cdr.f32(0.0); // time_increment: all beams at once
        cdr.f32(0.0); // scan_time: unknown
        cdr.f32(0.0); // range_min
        cdr.f32(self.range_max_m);
        cdr.sequence(self.ranges_m, |cdr, value| cdr.f32(*value));
        cdr.sequence(self.intensities, |cdr, value| cdr.f32(*value));
    }
}

/// A transform, written in a `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Copy, Debug)]
pub struct Transform {
    /// When, and the parent's frame.
    pub stamp: MarkerStamp,
    /// The child's frame.
    pub child: &'static str,
    /// Pose of the child in the parent.
    pub pose: MarkerPose,
}

/// Writes a whole `tf2_msgs/msg/TFMessage`.
pub fn write_transforms(transforms: &[Transform], cdr: &mut Cdr) {
    cdr.start();
    cdr.sequence(transforms, |cdr, transform| {
        transform.stamp.write(cdr);
        cdr.string(transform.child);
        transform.pose.write(cdr);
    });
}

/// What a marker is, in `visualization_msgs/Marker`'s numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkerShape {
    /// A box.
    Cube = 1,
    /// Points joined by a line.
    LineStrip = 4,
    /// Points joined two by two.
    LineList = 5,
    /// Text that turns to the viewer.
    Text = 9,
    /// Not a shape: removes every marker of the topic.
    DeleteAll = -1,
}

/// Red, green, blue, opacity, each 0 to 1.
pub type Colour = [f32; 4];

/// One `visualization_msgs/Marker`.
#[derive(Clone, Debug)]
pub struct Marker {
    /// When and in which frame.
    pub stamp: MarkerStamp,
    /// Namespace; with `id` it names the marker.
    pub namespace: &'static str,
    /// See `namespace`.
    pub id: i32,
    /// What is drawn.
    pub shape: MarkerShape,
    /// Where.
    pub pose: MarkerPose,
    /// Size in metres; a line's width or a text's height where the shape wants that.
    pub scale: [f64; 3],
    /// Its colour.
    pub colour: Colour,
    /// Points of a line, in metres in the marker's pose.
    pub points: Vec<[f64; 3]>,
    /// What a text says.
    pub text: String,
}

impl Marker {
    /// A marker without points or text.
    pub fn new(stamp: MarkerStamp, namespace: &'static str, id: i32, shape: MarkerShape) -> Self {
        Self {
            stamp,
            namespace,
            id,
            shape,
            pose: MarkerPose::default(),
            scale: [1.0; 3],
            colour: [1.0; 4],
            points: Vec::new(),
            text: String::new(),
        }
    }

    fn write(&self, cdr: &mut Cdr) {
        let (kind, action) = match self.shape {
            MarkerShape::DeleteAll => (0, 3),
            shape => (shape as i32, 0),
        };
        self.stamp.write(cdr);
        cdr.string(self.namespace);
        cdr.i32(self.id);
        cdr.i32(kind);
        cdr.i32(action);
        self.pose.write(cdr);
        for value in self.scale {
            cdr.f64(value);
        }
        for value in self.colour {
            cdr.f32(value);
        }
        cdr.i32(0); // lifetime: until deleted
        cdr.u32(0);
        cdr.bool(false); // frame_locked
        cdr.sequence(&self.points, |cdr, point| {
            for value in point {
                cdr.f64(*value);
            }
        });
        cdr.u32(0); // colors: the marker's own
        cdr.string(""); // texture_resource
        MarkerStamp {
            time_ns: 0,
            frame: "",
        }
        .write(cdr); // texture
        cdr.string("");
        cdr.u32(0);
        cdr.u32(0); // uv_coordinates
        cdr.string(&self.text);
        cdr.string(""); // mesh_resource
        cdr.string(""); // mesh_file
        cdr.u32(0);
        cdr.bool(false); // mesh_use_embedded_materials
    }
}

/// Writes a whole `visualization_msgs/msg/MarkerArray`.
pub fn write_markers(markers: &[Marker], cdr: &mut Cdr) {
    cdr.start();
    cdr.sequence(markers, |cdr, marker| marker.write(cdr));
}
