//! All messages in one list, for whoever treats them alike: the recorder's schemas, tests, documentation.

use crate::*;

/// A message's description.
#[derive(Clone, Copy, Debug)]
pub struct Description {
    /// See [`Message::TYPE_NAME`].
    pub type_name: &'static str,
    /// See [`Message::ROS_TYPE`].
    pub ros_type: &'static str,
    /// See [`Message::DOC`].
    pub doc: &'static str,
    /// See [`Message::fields`].
    pub fields: &'static [Field],
    /// See [`Message::layout`].
    pub layout: u64,
    /// Bytes.
    pub size: usize,
    /// See [`Message::definition`].
    pub definition: fn() -> String,
}

impl Description {
    /// Type name and layout, as the attribute of a topic's service carries them: see [`Message::layout_text`].
    pub fn layout_text(&self) -> String {
        layout_text(self.type_name, self.layout)
    }
}

fn description<M: Message>() -> Description {
    Description {
        type_name: M::TYPE_NAME,
        ros_type: M::ROS_TYPE,
        doc: M::DOC,
        fields: M::fields(),
        layout: M::layout(),
        size: size_of::<M>(),
        definition: M::definition,
    }
}

fn describe<M: Message>(visit: &mut impl FnMut(Description)) {
    visit(description::<M>());
}

/// Calls `visit` with every message, in the order of a step.
pub fn for_each_message(mut visit: impl FnMut(Description)) {
    describe::<Header>(&mut visit);
    describe::<LidarFrame>(&mut visit);
    describe::<Observation>(&mut visit);
    describe::<Picture>(&mut visit);
    describe::<ObjectPose>(&mut visit);
    describe::<Scene>(&mut visit);
    describe::<Outcome>(&mut visit);
    describe::<RobotBelief>(&mut visit);
    describe::<HumanBelief>(&mut visit);
    describe::<CommAction>(&mut visit);
    describe::<Utterance>(&mut visit);
    describe::<Display>(&mut visit);
    describe::<DriverAction>(&mut visit);
    describe::<Cockpit>(&mut visit);
    describe::<ImagineRequest>(&mut visit);
    describe::<ImagineAnswer>(&mut visit);
    describe::<Control>(&mut visit);
    describe::<PortCount>(&mut visit);
    describe::<Report>(&mut visit);
    describe::<Progress>(&mut visit);
}

/// Calls `visit` with every topic and the message that travels on it.
pub fn for_each_topic(mut visit: impl FnMut(&'static str, Description)) {
    visit(topic::LIDAR, description::<LidarFrame>());
    visit(topic::OBSERVATION, description::<Observation>());
    visit(topic::PICTURE, description::<Picture>());
    visit(topic::SCENE, description::<Scene>());
    visit(topic::MOTION, description::<Scene>());
    visit(topic::OUTCOME, description::<Outcome>());
    visit(topic::ROBOT_BELIEF, description::<RobotBelief>());
    visit(topic::HUMAN_BELIEF, description::<HumanBelief>());
    visit(topic::COMM_ACTION, description::<CommAction>());
    visit(topic::DISPLAY, description::<Display>());
    visit(topic::DRIVER_ACTION, description::<DriverAction>());
    visit(topic::COCKPIT, description::<Cockpit>());
    visit(topic::IMAGINE, description::<ImagineRequest>());
    visit(topic::IMAGINE_ANSWER, description::<ImagineAnswer>());
    visit(topic::CONTROL, description::<Control>());
    visit(topic::REPORT, description::<Report>());
    visit(topic::PROGRESS, description::<Progress>());
}

/// Type name, layout and ROS 2 definition of every message.
pub fn all_definitions() -> String {
    let mut out = String::new();
    for_each_message(|message| {
        out.push_str(&format!(
            "### {} {} layout {:016x} {} bytes\n{}\n",
            message.type_name,
            message.ros_type,
            message.layout,
            message.size,
            (message.definition)()
        ));
    });
    out
}
