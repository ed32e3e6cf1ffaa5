//! The device, its buffers, and sums.

use glam::Vec3;
use surfcut::gpu::layers::GpuLayers;
use surfcut::gpu::{Gpu, GpuError, scan};
use surfcut::layers::{Boundary, Facing, LayerTile};
use surfcut::space::PixelRect;

use crate::Test;

pub const TESTS: &[Test] = &[
    ("sums_are_those_of_the_numbers_before", sums_are_those_of_the_numbers_before),
    ("layers_come_back_as_they_went", layers_come_back_as_they_went),
    ("a_lost_device_is_an_error_that_says_so", a_lost_device_is_an_error_that_says_so),
    ("a_name_that_no_adapter_has_names_those_there_are", a_name_that_no_adapter_has_names_those_there_are),
    ("what_fits_no_buffer_is_refused_before_it_is_made", what_fits_no_buffer_is_refused_before_it_is_made),
];

fn sums_are_those_of_the_numbers_before(gpu: &'static Gpu) {
    for count in [1_usize, 63, 512, 513, 40_000, 600_001] {
        let numbers: Vec<u32> =
            (0..count).map(|i| if i + 1 == count { 0 } else { (i as u32).wrapping_mul(7919) % 11 }).collect();
        let buffer = gpu.upload("numbers", &numbers).unwrap();
        let mut commands = gpu.commands();
        scan::exclusive(gpu, &mut commands, &buffer, count).unwrap();
        commands.submit();
        let mut sum = 0;
        let before = |number: &u32| {
            sum += number;
            sum - number
        };
        let expected: Vec<u32> = numbers.iter().map(before).collect();
        assert_eq!(gpu.download::<u32>(&buffer, count).unwrap(), expected);
    }
}

fn layers_come_back_as_they_went(gpu: &'static Gpu) {
    let boundary = |depth: f32, facing| Boundary {
        depth,
        normal: Vec3::new(0.6, 0.0, -0.8),
        colour: [0.1, 0.2, 0.3],
        opacity: 0.5,
        leaf: 3,
        body: 1,
        facing,
        samples: 0b1010,
    };
    let tile = LayerTile {
        rect: PixelRect { x0: 1, y0: 2, x1: 3, y1: 3 },
        offsets: vec![0, 0, 2],
        boundaries: vec![boundary(1.0, Facing::Front), boundary(2.0, Facing::Back)],
    };
    let back = GpuLayers::upload(gpu, &tile).unwrap().download(gpu).unwrap();
    assert_eq!((back.rect, back.offsets, back.boundaries), (tile.rect, tile.offsets, tile.boundaries));
}

fn a_lost_device_is_an_error_that_says_so(_: &'static Gpu) {
    let gpu = Gpu::open(None).unwrap();
    gpu.lose();
    let drawn = gpu.checked(|| {
        let buffer = gpu.upload("numbers", &[0_u32; 64])?;
        gpu.download::<u32>(&buffer, 64)
    });
    assert!(matches!(drawn, Err(GpuError::Lost(_))), "{drawn:?}");
    // While it draws.
    let gpu = Gpu::open(None).unwrap();
    let drawn = gpu.checked(|| {
        let buffer = gpu.upload("numbers", &[0_u32; 64])?;
        gpu.lose();
        gpu.upload("more numbers", &[0_u32; 64])?;
        gpu.download::<u32>(&buffer, 64)
    });
    assert!(matches!(drawn, Err(GpuError::Lost(_))), "{drawn:?}");
}

fn a_name_that_no_adapter_has_names_those_there_are(_: &'static Gpu) {
    let error = Gpu::open(Some("no such adapter")).unwrap_err();
    let GpuError::NoSuchAdapter { found, .. } = &error else { panic!("{error:?}") };
    assert!(found.iter().all(|name| error.to_string().contains(name.as_str())));
}

fn what_fits_no_buffer_is_refused_before_it_is_made(gpu: &'static Gpu) {
    let made = gpu.storage::<u32>("too many", (gpu.largest_binding() / 4) as usize + 1);
    assert!(matches!(made, Err(GpuError::TooLarge { .. })), "{made:?}");
}
