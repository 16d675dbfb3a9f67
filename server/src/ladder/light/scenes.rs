//! What the ladder of light is measured on: seven pictures whose light is hard in seven ways.

use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::view::ViewSettings;

use crate::clouds::{ball, cumulus_field, settings, sun};

/// One picture.
pub(in crate::ladder) struct Picture {
    pub(in crate::ladder) name: &'static str,
    pub(in crate::ladder) what: &'static str,
    pub(in crate::ladder) volume: CloudVolume,
    pub(in crate::ladder) settings: ViewSettings,
}

fn thinned(mut volume: CloudVolume, factor: f32) -> CloudVolume {
    volume.extinction_per_m.iter_mut().for_each(|v| *v *= factor);
    volume
}

/// All of them, `width` by `height` pixels.
pub(in crate::ladder) fn all(width: usize, height: usize) -> Vec<Picture> {
    let base = settings(width, height);
    let picture = |name, what, volume, settings| Picture {
        name,
        what,
        volume,
        settings,
    };
    vec![
        picture(
            "thin",
            "cumulus of a twentieth of its extinction, the sun behind the viewer",
            thinned(cumulus_field(7, 12), 0.05),
            base,
        ),
        picture(
            "thick",
            "a ball of 1400 m with 0.06 1/m, optical depth 84, lit from the side",
            ball(1500.0, 700.0, 0.06),
            ViewSettings {
                camera_position_m: [3200.0, -200.0, 300.0],
                vertical_fov_deg: 45.0,
                elevation_deg: 19.0,
                ..base
            },
        ),
        picture(
            "broken-field",
            "broken cumulus from the ground",
            cumulus_field(7, 12),
            base,
        ),
        picture(
            "sunset",
            "the same with the sun 4 degrees high at the right",
            cumulus_field(7, 12),
            ViewSettings {
                sun_direction: sun(4.0, 70.0),
                ..base
            },
        ),
        picture(
            "inside",
            "inside the edge of the ball, looking out and up",
            ball(1500.0, 700.0, 0.01),
            ViewSettings {
                camera_position_m: [3200.0, 3700.0, 1700.0],
                ..base
            },
        ),
        picture(
            "into-the-sun",
            "the sun in the middle of the picture behind cumulus of a tenth of its extinction",
            thinned(cumulus_field(11, 14), 0.1),
            ViewSettings {
                sun_direction: sun(24.0, 0.0),
                elevation_deg: 24.0,
                ..base
            },
        ),
        picture(
            "antisolar",
            "from above, around the point opposite the sun",
            cumulus_field(5, 40),
            ViewSettings {
                camera_position_m: [3200.0, 0.0, 4200.0],
                elevation_deg: -50.0,
                vertical_fov_deg: 90.0,
                sun_direction: sun(50.0, 180.0),
                ..base
            },
        ),
    ]
}
