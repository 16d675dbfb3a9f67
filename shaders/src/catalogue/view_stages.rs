//! The stages of light and view: what runs for a picture, in order.

use super::{Effect, Rung};

/// A stage of light or view: it runs for a picture, on a published cloud, outside the tick, and writes no field of the state.
#[derive(Debug)]
pub struct ViewStage {
    /// The stage's name; its file is `cpu/light/NAME.rs` or `cpu/view/NAME.rs`, and `wgsl/light/NAME.wgsl` or `wgsl/view/NAME.wgsl` (a part of a
    /// stage stands behind a colon).
    pub name: &'static str,
    /// The effects that must all be present; none: every picture needs it.
    pub needs: &'static [Effect],
    /// The rungs of which one must be chosen; none: it runs whatever is.
    pub rungs: &'static [Rung],
    /// What it reads.
    pub reads: &'static [&'static str],
    /// What it writes.
    pub writes: &'static [&'static str],
    /// One line: what it does.
    pub what: &'static str,
    /// How far its results on the two devices may be apart.
    pub tolerance: Tolerance,
}

/// How far a stage's results on two devices may be apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// The largest difference of two values.
    pub within: Within,
    /// Share of the values that may be farther apart.
    pub outside: f32,
    /// Why so much, and no more.
    pub why: &'static str,
}

/// A bound on a difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Within {
    /// A share of the value and of a hundredth of the largest value.
    Relative(f32),
    /// In the result's own unit; packed numbers in steps, pictures in levels of 8 bits.
    Absolute(f32),
}

/// Pictures: the same samples of the same field, summed in the same order.
const PICTURE: Tolerance = Tolerance {
    within: Within::Absolute(1.0),
    outside: 0.001,
    why: "levels are rounded down, so the last bit of a sum can cost one; where it moves a ray over a cell's border of the occupancy, the \
          samples behind shift by a step and the pixel by some levels: one in thousands",
};

/// The stages of light and view, in order.
pub const VIEW_STAGES: &[ViewStage] = &[
    ViewStage {
        name: "transmittance_table",
        needs: &[],
        rungs: &[],
        reads: &["atmosphere"],
        writes: &["air_transmittance"],
        what: "sunlight through clear air, by height and direction",
        tolerance: Tolerance {
            within: Within::Relative(1e-4),
            outside: 0.0,
            why: "heights and distances are 32-bit floats here and 64-bit ones in the twin: 1e-7 of the Earth's radius is half a metre, 1e-4 of a scale height",
        },
    },
    ViewStage {
        name: "multiple_scattering_table",
        needs: &[],
        rungs: &[],
        reads: &["atmosphere", "air_transmittance"],
        writes: &["air_multiple_scattering"],
        what: "light scattered more than once in clear air",
        tolerance: Tolerance {
            within: Within::Relative(3e-4),
            outside: 0.0,
            why: "sums over 32 directions in another order, of lookups at heights that differ by half a metre",
        },
    },
    ViewStage {
        name: "sky_table",
        needs: &[],
        rungs: &[],
        reads: &[
            "atmosphere",
            "air_transmittance",
            "air_multiple_scattering",
            "sun_direction",
        ],
        writes: &["sky_radiance"],
        what: "the clear sky as seen from the camera",
        tolerance: Tolerance {
            within: Within::Relative(4e-4),
            outside: 0.0,
            why: "28 steps, each looking up two tables at heights that differ by half a metre",
        },
    },
    ViewStage {
        name: "analytic_sky",
        needs: &[],
        rungs: &[Rung::Preetham, Rung::HosekWilkie],
        reads: &["atmosphere", "sun_direction"],
        writes: &["sky_radiance", "sun_and_sky_on_cloud_and_ground"],
        what: "the sky by a formula in place of the tables', where the scene's methods name one (within sky_table and sky_light)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.001,
            why: "computed on the CPU for both devices; judged by pictures",
        },
    },
    ViewStage {
        name: "sky_light",
        needs: &[],
        rungs: &[],
        reads: &["air_transmittance", "air_multiple_scattering", "sun_direction"],
        writes: &["sun_and_sky_on_cloud_and_ground"],
        what: "what sun, sky and ground give to clouds and land",
        tolerance: Tolerance {
            within: Within::Relative(1e-4),
            outside: 0.0,
            why: "a mean over rays as those of the sky table",
        },
    },
    ViewStage {
        name: "shape",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &["extinction"],
        writes: &["cloud_cover_and_amplitude"],
        what: "the cloud as a smooth field, twice as fine as the grid",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.0,
            why: "16-bit steps are rounded down, so the last bit of a sum can cost one",
        },
    },
    ViewStage {
        name: "occupancy",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &["cloud_cover_and_amplitude"],
        writes: &["empty_distance"],
        what: "how far a ray may leap over empty air (within shape)",
        tolerance: Tolerance {
            within: Within::Absolute(0.0),
            outside: 0.0,
            why: "small whole numbers of metres, squared: exact in both",
        },
    },
    ViewStage {
        name: "sky_visibility",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &["extinction"],
        writes: &["sky_and_ground_visibility"],
        what: "how much light of sky and ground reaches the inside of clouds",
        tolerance: Tolerance {
            within: Within::Absolute(1e-6),
            outside: 0.0,
            why: "the same sums in the same order, fused or not",
        },
    },
    ViewStage {
        name: "sun_optical_depth",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &[
            "cloud_cover_and_amplitude",
            "sky_and_ground_visibility",
            "sun_direction",
        ],
        writes: &["sun_optical_depth", "ground_shadow"],
        what: "how much cloud lies towards the sun",
        tolerance: Tolerance {
            within: Within::Absolute(2.0),
            outside: 0.0001,
            why: "16-bit steps of a sum of some 50 samples; a sample on a cell's border of the occupancy may be leapt over on one side",
        },
    },
    ViewStage {
        name: "march_phase",
        needs: &[Effect::Moisture],
        rungs: &[],
        reads: &[],
        writes: &["phase_of_single_scattering_and_octaves", "level_shares"],
        what: "how droplets turn light, as the march looks it up",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.001,
            why: "computed on the CPU for both devices; judged by pictures",
        },
    },
    ViewStage {
        name: "sun_map",
        needs: &[Effect::Moisture],
        rungs: &[Rung::ExponentialShadowMap, Rung::BeerShadowMap, Rung::FourierOpacityMap],
        reads: &["cloud_cover_and_amplitude", "detail_tile", "sun_direction"],
        writes: &["sun_map"],
        what: "what the sun's rays meet, a map as seen from the sun",
        tolerance: Tolerance {
            within: Within::Relative(2e-3),
            outside: 0.001,
            why: "sums of up to 256 samples of packed numbers; a sample on a cell's border of the occupancy may be leapt over on one side, and moves where a ray's cloud begins by a step",
        },
    },
    ViewStage {
        name: "octave_balance",
        needs: &[Effect::Moisture, Effect::MultipleScattering],
        rungs: &[Rung::Octaves],
        reads: &[
            "cloud_cover_and_amplitude",
            "sun_optical_depth",
            "phase_of_single_scattering_and_octaves",
            "level_shares",
            "sun_direction",
        ],
        writes: &["octave_balance"],
        what: "how strong octaves are over each column, so that clouds send out what they take from the beam",
        tolerance: Tolerance {
            within: Within::Relative(1e-2),
            outside: 0.001,
            why: "sums over columns of sums over directions of exponentials; a step on a cell's border of the occupancy may end a way on one side and not on the other",
        },
    },
    ViewStage {
        name: "diffusion",
        needs: &[Effect::Moisture],
        rungs: &[Rung::Diffusion],
        reads: &["cloud_cover_and_amplitude", "sun_optical_depth"],
        writes: &["diffuse_light"],
        what: "sunlight that cloud has scattered so often that it goes all ways, within clouds and from one to the other",
        tolerance: Tolerance {
            within: Within::Absolute(0.5),
            outside: 0.001,
            why: "codes of the same sums in the same order, fused or not (but for one over the grid, of light between clouds); exponentials differ in the last bits, the cycles make no more of that than light does, and what lies on a code's border falls to either side",
        },
    },
    ViewStage {
        name: "detail_noise",
        needs: &[Effect::CloudDetail],
        rungs: &[],
        reads: &[],
        writes: &["detail_tile"],
        what: "the pattern that carves edges finer than a cell",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.0,
            why: "bytes are rounded, so the last bit of a sum can cost one",
        },
    },
    ViewStage {
        name: "march:octaves",
        needs: &[Effect::MultipleScattering],
        rungs: &[Rung::Octaves],
        reads: &["sun_optical_depth", "octave_balance"],
        writes: &["scattered_octaves"],
        what: "light scattered more than once inside cloud (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "march",
        needs: &[],
        rungs: &[],
        reads: &[
            "sky_radiance",
            "sun_and_sky_on_cloud_and_ground",
            "cloud_cover_and_amplitude",
            "sun_optical_depth",
            "detail_tile",
        ],
        writes: &["radiance"],
        what: "rays of view through sky and cloud to the ground",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "march:steps",
        needs: &[Effect::Moisture],
        rungs: &[Rung::LogarithmicSegments, Rung::ByOpticalDepth],
        reads: &["cloud_cover_and_amplitude"],
        writes: &["radiance"],
        what: "other lengths of the steps through cloud (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "upsample",
        needs: &[Effect::Moisture],
        rungs: &[Rung::HalfResolution],
        reads: &["radiance", "cloud_transmittance", "cloud_distance"],
        writes: &["picture"],
        what: "a live picture from one pixel in four and those between which they disagree (march is then those one in four, and the rest of it within this)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.002,
            why: "as of march; and where samples disagree by just the bound, one device marches a pixel that the other fills: one in thousands, some levels apart",
        },
    },
    ViewStage {
        name: "reproject",
        needs: &[Effect::Moisture],
        rungs: &[Rung::Reproject4, Rung::Reproject16],
        reads: &["radiance", "cloud_transmittance", "cloud_distance", "last_picture"],
        writes: &["picture"],
        what: "a live picture from one pixel in 4 or 16 and the viewer's last one (march within it)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.002,
            why: "as of upsample; a pixel that one device looks up and the other marches is within the bounds of what is around it, and the next picture looks it up again",
        },
    },
    ViewStage {
        name: "impostors",
        needs: &[Effect::Moisture],
        rungs: &[Rung::Impostors],
        reads: &["radiance", "cloud_transmittance", "cloud_distance", "far_clouds_kept"],
        writes: &["picture"],
        what: "a live picture whose far clouds stand on pictures kept of them (march within it)",
        tolerance: Tolerance {
            within: Within::Absolute(1.0),
            outside: 0.002,
            why: "as of march; and a direction of far cloud that rounding moves over a cell's border shows in the pixels around it",
        },
    },
    ViewStage {
        name: "layers",
        needs: &[],
        rungs: &[],
        reads: &["radiance", "objects_distance"],
        writes: &["layers"],
        what: "what a client needs to put objects into a picture: light before them, what passes, where the cloud is (when asked for)",
        tolerance: Tolerance {
            within: Within::Relative(2e-3),
            outside: 0.002,
            why: "sums of some 20 samples of packed numbers; where rounding moves a ray over a cell's border of the occupancy, the samples behind shift by a step: one in thousands",
        },
    },
    ViewStage {
        name: "ground",
        needs: &[],
        rungs: &[],
        reads: &["sun_and_sky_on_cloud_and_ground"],
        writes: &["radiance"],
        what: "the land (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "ground:shadow",
        needs: &[Effect::CloudShadow],
        rungs: &[],
        reads: &["ground_shadow"],
        writes: &["radiance"],
        what: "the clouds' shadow on the land (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "haze",
        needs: &[Effect::AerialPerspective],
        rungs: &[],
        reads: &["atmosphere"],
        writes: &["radiance"],
        what: "the air between the camera and the cloud (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "light_shafts",
        needs: &[Effect::LightShafts],
        rungs: &[],
        reads: &[
            "atmosphere",
            "sun_and_sky_on_cloud_and_ground",
            "sun_optical_depth",
            "ground_shadow",
        ],
        writes: &["radiance"],
        what: "the clouds' shadows in the air (within march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "moon",
        needs: &[Effect::Moon],
        rungs: &[],
        reads: &["moon_direction", "sun_direction", "air_transmittance"],
        writes: &["sky_radiance", "sun_and_sky_on_cloud_and_ground", "radiance"],
        what: "the moon's disc, and by night its sky and its beam in place of the sun's (within sky_table, sky_light and march)",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "stars",
        needs: &[Effect::Stars],
        rungs: &[],
        reads: &["star_catalogue", "sidereal_time", "air_transmittance"],
        writes: &["star_table", "radiance"],
        what: "the stars by night: a table once, then within march",
        tolerance: PICTURE,
    },
    ViewStage {
        name: "tone_map",
        needs: &[],
        rungs: &[],
        reads: &["radiance"],
        writes: &["picture"],
        what: "exposure, filmic curve, sRGB (within march)",
        tolerance: PICTURE,
    },
];
