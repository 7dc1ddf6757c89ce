//! Writes a drawing as SVG and as PNG.

use anyhow::{Context, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use std::path::Path;

/// Something that can be drawn with any of the plot library's backends.
pub(crate) trait Drawing {
    /// Draws on the whole of `root`.
    ///
    /// # Errors
    /// What the backend says.
    fn draw_on<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static;
}

/// Draws into `stem.svg` and `stem.png`, `size` pixels wide and high.
///
/// # Errors
/// If a file cannot be written.
pub(crate) fn write(drawing: &impl Drawing, size: (u32, u32), stem: &Path) -> anyhow::Result<()> {
    register_font();
    let (svg, png) = (stem.with_extension("svg"), stem.with_extension("png"));
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        drawing
            .draw_on(&root)
            .map_err(|e| anyhow!("{}: {e}", svg.display()))?;
        root.present()
            .map_err(|e| anyhow!("{}: {e}", svg.display()))?;
    }
    files::write(&svg, text.as_bytes())?;
    let mut pixels = vec![0; 3 * size.0 as usize * size.1 as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area();
        drawing
            .draw_on(&root)
            .map_err(|e| anyhow!("{}: {e}", png.display()))?;
        root.present()
            .map_err(|e| anyhow!("{}: {e}", png.display()))?;
    }
    let bytes = encode(&pixels, size).with_context(|| png.display().to_string())?;
    Ok(files::write(&png, &bytes)?)
}

/// A PNG of red, green and blue bytes, row after row.
fn encode(pixels: &[u8], size: (u32, u32)) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}

/// Bitmaps need a font of their own: the machine may have none.
fn register_font() {
    const FONT: &[u8] = include_bytes!("../fonts/DejaVuSans.ttf");
    // Registering again, or a font that the library refuses, only means that drawing says so itself.
    let _ = plotters::style::register_font("sans-serif", FontStyle::Normal, FONT);
}
