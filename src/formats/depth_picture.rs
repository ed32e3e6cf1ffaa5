//! Pictures with depth, from other programs or from this one: OpenEXR with the channels `R G B` (and `A`) and `Z`.
//!
//! *Practice.* `Z` is planar view depth in scene units, seen by the same camera, as renderers write it; +∞, or a number beyond
//! [`FAR`], is where nothing is. Colours are linear and premultiplied, as the format asks. The header is read first, so that a
//! picture of another size is refused before its pixels take any memory.

use std::path::{Path, PathBuf};

use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, read as exr_read};

/// Depths from here on are "nothing": Blender writes 1e10, others the largest number there is.
pub const FAR: f32 = 1e9;

/// Linear, premultiplied colours with depths, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthPicture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Premultiplied linear RGB and alpha.
    pub pixels: Vec<[f32; 4]>,
    /// Planar view depth, scene units; +∞ where nothing is.
    pub depth: Vec<f32>,
}

/// Why a file cannot be composed with a picture.
#[derive(Debug, thiserror::Error)]
pub enum DepthPictureError {
    /// The file cannot be read.
    #[error("{}: it cannot be read as OpenEXR: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The reader's words.
        reason: String,
    },
    /// It has another size than the picture.
    #[error(
        "{} has {}x{} pixels, and the picture {}x{}: draw both in one size (--size {}x{})",
        path.display(), found.0, found.1, wanted.0, wanted.1, found.0, found.1
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Its width and height.
        found: (usize, usize),
        /// The picture's.
        wanted: (u32, u32),
    },
    /// A channel is missing.
    #[error("{} has no channel `{channel}` (it has {}): it needs R, G, B and Z, and may have A", path.display(), present.join(", "))]
    Channel {
        /// The file.
        path: PathBuf,
        /// Which.
        channel: &'static str,
        /// Those that it has.
        present: Vec<String>,
    },
    /// A pixel is not a number.
    #[error("{}: the pixel at column {x}, row {y} is not a number in `{channel}`: mend the file", path.display())]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// The channel.
        channel: &'static str,
        /// Column, from 0.
        x: usize,
        /// Row, from 0.
        y: usize,
    },
}

/// The picture in the file at `path`, which must have `size` (width, height) pixels.
///
/// # Errors
/// [`DepthPictureError`] names the file.
pub fn read(path: &Path, size: (u32, u32)) -> Result<DepthPicture, DepthPictureError> {
    let path_buf = || path.to_owned();
    let unreadable =
        |error: exr::error::Error| DepthPictureError::Unreadable { path: path.to_owned(), reason: error.to_string() };
    let wanted = (size.0 as usize, size.1 as usize);
    let meta = MetaData::read_from_file(path, true).map_err(unreadable)?;
    let found = meta.headers.first().map_or((0, 0), |header| (header.layer_size.0, header.layer_size.1));
    if found != wanted {
        return Err(DepthPictureError::Size { path: path_buf(), found, wanted: size });
    }
    let image = exr_read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(unreadable)?;
    let list = &image.layer_data.channel_data.list;
    let channel = |name: &'static str| -> Option<Vec<f32>> {
        let channel = list.iter().find(|channel| channel.name.to_string() == name)?;
        Some(channel.sample_data.values_as_f32().collect())
    };
    let required = |name: &'static str| {
        channel(name).ok_or_else(|| DepthPictureError::Channel {
            path: path_buf(),
            channel: name,
            present: list.iter().map(|channel| channel.name.to_string()).collect(),
        })
    };
    let (r, g, b, mut depth) = (required("R")?, required("G")?, required("B")?, required("Z")?);
    // Nothing is there where nothing is near enough.
    depth.iter_mut().filter(|z| **z >= FAR).for_each(|z| *z = f32::INFINITY);
    let a = channel("A").unwrap_or_else(|| depth.iter().map(|z| if z.is_finite() { 1.0 } else { 0.0 }).collect());
    for (name, values) in [("R", &r), ("G", &g), ("B", &b), ("A", &a), ("Z", &depth)] {
        if let Some(at) = values.iter().position(|value| value.is_nan()) {
            return Err(DepthPictureError::NotANumber {
                path: path_buf(),
                channel: name,
                x: at % wanted.0,
                y: at / wanted.0,
            });
        }
    }
    let pixels = (0..depth.len()).map(|i| [r[i], g[i], b[i], a[i].clamp(0.0, 1.0)]).collect();
    Ok(DepthPicture { width: size.0, height: size.1, pixels, depth })
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{
        AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, WritableImage,
    };

    fn write(path: &Path, channels: &[(&str, Vec<f32>)], size: (usize, usize)) {
        let list: SmallVec<[AnyChannel<FlatSamples>; 4]> =
            channels.iter().map(|(name, values)| AnyChannel::new(*name, FlatSamples::F32(values.clone()))).collect();
        let layer = Layer::new(size, LayerAttributes::default(), Encoding::default(), AnyChannels::sort(list));
        Image::from_layer(layer).write().to_file(path).unwrap();
    }

    #[test]
    fn colours_and_depths_come_back_and_far_is_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let channels = |z: Vec<f32>| {
            [("R", vec![0.5, 0.25]), ("G", vec![0.1, 0.2]), ("B", vec![0.0, 9.0]), ("Z", z), ("Mist", vec![0.0; 2])]
        };
        write(&path, &channels(vec![3.5, 1e10]), (2, 1));
        let picture = read(&path, (2, 1)).unwrap();
        assert_eq!(picture.depth, [3.5, f32::INFINITY]);
        // Without an alpha, what is there is opaque.
        assert_eq!(picture.pixels, [[0.5, 0.1, 0.0, 1.0], [0.25, 0.2, 9.0, 0.0]]);
    }

    #[test]
    fn what_cannot_be_composed_is_refused_by_name() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let ones = || vec![1.0; 2];
        write(&path, &[("R", ones()), ("G", ones()), ("B", ones())], (2, 1));
        let message = |size| read(&path, size).unwrap_err().to_string();
        assert!(message((2, 1)).contains("no channel `Z` (it has B, G, R)"), "{}", message((2, 1)));
        assert!(message((3, 1)).contains("2x1") && message((3, 1)).contains("--size 2x1"));
        write(&path, &[("R", ones()), ("G", ones()), ("B", ones()), ("Z", vec![1.0, f32::NAN])], (2, 1));
        assert!(message((2, 1)).contains("column 1, row 0"), "{}", message((2, 1)));
        std::fs::write(&path, "no picture").unwrap();
        assert!(message((2, 1)).contains("OpenEXR"));
    }
}
