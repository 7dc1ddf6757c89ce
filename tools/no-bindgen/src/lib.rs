//! Nothing, in the place of bindgen. iceoryx2's build scripts depend on bindgen on every system, but call it for QNX alone;
//! building it and what it needs takes longer than building iceoryx2 itself.
