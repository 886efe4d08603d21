//! The sections of a specification.

use super::{Response, section};

section! {
    /// The camera: a pinhole without distortion, principal point in the middle.
    camera: CameraSpec {
        /// Number of frames.
        frames: usize = 80, 1.0..=100_000.0;
        /// Frames a second.
        frame_rate: f64 = 30.0, 1.0..=1000.0;
        /// Width of the pictures [px].
        width: usize = 320, 16.0..=8192.0;
        /// Height of the pictures [px].
        height: usize = 240, 16.0..=8192.0;
        /// Horizontal field of view [degrees].
        field_of_view: f64 = 65.0, 10.0..=140.0;
        /// Pictures averaged in linear light over the exposure.
        sub_frames: usize = 32, 1.0..=1024.0;
        /// Samples a pixel, each way, of the sharp pictures.
        sharp_samples: usize = 3, 1.0..=16.0;
        /// Time in which the rows are read, share of the frame interval; 0 is a global shutter.
        /// Row y is exposed around time stamp + (y + 0.5 - height/2) / height * readout. Sharp
        /// pictures and depth always show one time, that of the stamp.
        readout: f64 = 0.0, 0.0..=1.0;
    }
}

section! {
    /// The room and what stands in it.
    room: RoomSpec {
        /// Width, depth and height [m].
        size: [f64; 3] = [5.4, 4.6, 2.6], 2.4..=12.0;
        /// Windows in one wall, as many as fit.
        windows: usize = 2, 0.0..=6.0;
        /// Panels with fine text on the walls.
        text_panels: usize = 5, 0.0..=6.0;
        /// Share of shelf space that is filled.
        clutter: f64 = 0.8, 0.0..=1.0;
    }
}

section! {
    /// The light. The median radiance of the room is the same always; ratios are set here.
    light: LightSpec {
        /// Light of the sky through the windows, relative.
        daylight: f64 = 1.0, 0.0..=100.0;
        /// Light of lamps, relative.
        lamps: f64 = 0.05, 0.0..=100.0;
        /// Light of a lamp over the desk, relative; 0 is no such lamp.
        desk_lamp: f64 = 0.0, 0.0..=100.0;
        /// Irradiance of the sun that falls through the windows, relative; 0 is an overcast sky.
        sun: f64 = 5.0, 0.0..=1000.0;
        /// Height of the sun over the horizon [degrees].
        sun_elevation: f64 = 36.0, 0.0..=89.0;
        /// Direction of the sun from the middle of the window wall to its right [degrees].
        sun_azimuth: f64 = 28.0, -80.0..=80.0;
        /// Share of reflected light that is kept; less gives darker shades and more contrast.
        reflections: f64 = 0.4, 0.0..=1.0;
        /// Brightness of the outside: mean over the room's median radiance [stops].
        window_stops: f64 = 4.0, -2.0..=10.0;
        /// Spacing at which light is computed on surfaces [m]; reflected light five times wider.
        texel: f64 = 0.02, 0.005..=0.5;
    }
}

section! {
    /// Gloss: light that is reflected about the mirror direction, by Schlick's formula for the
    /// reflectance. What it throws onto other surfaces is left out.
    gloss: GlossSpec {
        /// Reflectance of floor, furniture and glazes at normal incidence; 0.04 is varnish, 0 is
        /// matt. Polished floors have no rug, polished tables no cloth.
        polish: f64 = 0.0, 0.0..=1.0;
        /// Standard deviation of reflected directions along each axis [degrees]; 0 is a clear image.
        /// The floor's is twice as large.
        spread: f64 = 1.0, 0.0..=20.0;
        /// Whether a mirror hangs above the sofa in place of the paintings.
        mirror: bool = false;
    }
}

section! {
    /// The lens.
    lens: LensSpec {
        /// Vignetting: a, b, c of the factor 1 + a r^2 + b r^4 + c r^6 on linear light, r the
        /// distance from the middle of the picture over half its diagonal; 0.0 thrice is none.
        vignetting: [f64; 3] = [0.0; 3], -8.0..=8.0;
    }
}

section! {
    /// Photographs around an object, in place of a film: a still life stands in the middle of the
    /// room, and every photograph has a motion of its own. They are taken at the frame rate.
    stills: StillsSpec {
        /// Whether there are such; the section on motion then says nothing.
        around_object: bool = false;
        /// Least and largest distance from the object [m].
        distance: [f64; 2] = [0.75, 1.1], 0.5..=1.5;
        /// Least and largest length of the blur, in pictures 640 px wide [px].
        blur: [f64; 2] = [5.0, 20.0], 0.0..=200.0;
        /// Every n-th photograph is sharp, from the first one on; 0 is none.
        sharp_every: usize = 7, 0.0..=100_000.0;
    }
}

section! {
    /// The motion: a spline around the room or before the desk, hand tremor, rotation bursts, and a
    /// turn away and back.
    motion: MotionSpec {
        /// Walking speed [m/s].
        speed: f64 = 0.4, 0.0..=5.0;
        /// Height of the camera [m].
        height: f64 = 1.4, 0.3..=3.0;
        /// Direction of view to the left of the middle of the room [degrees]; 180 looks outwards.
        facing: f64 = 0.0, -180.0..=180.0;
        /// Panning to both sides of that direction [degrees].
        sweep: f64 = 40.0, 0.0..=180.0;
        /// Time from one side to the other and back [s].
        sweep_period: f64 = 6.0, 0.2..=1000.0;
        /// Spread of the direction of view in looking around, new every 0.7 s [degrees].
        look_around: f64 = 14.0, 0.0..=120.0;
        /// Mean inclination of the view [degrees], negative is down.
        pitch: f64 = -12.0, -60.0..=60.0;
        /// Standard deviation of tremor in position [m].
        tremor_position: f64 = 0.003, 0.0..=0.2;
        /// Standard deviation of tremor in rotation [degrees].
        tremor_rotation: f64 = 0.35, 0.0..=20.0;
        /// Band of the tremor, lowest and highest frequency [Hz].
        tremor_band: [f64; 2] = [1.0, 8.0], 0.05..=60.0;
        /// Bursts of fast rotation a second, on average.
        bursts: f64 = 0.8, 0.0..=20.0;
        /// Angle of a burst [degrees], there and back.
        burst_angle: f64 = 7.0, 0.0..=90.0;
        /// Time of a burst [s], standard deviation of its bell curve.
        burst_time: f64 = 0.09, 0.01..=2.0;
        /// Whether the camera stands before the desk and faces it, instead of walking around the
        /// room; facing, sweep, look_around and pitch are then off that direction.
        at_desk: bool = false;
        /// Angle by which the camera turns away to the right, once, and back [degrees]; 0 is not.
        turn_away: f64 = 0.0, -180.0..=180.0;
        /// Time at which it begins to turn away [s].
        turn_start: f64 = 1.5, 0.0..=10_000.0;
        /// Time of the turn, each way [s]; it is fastest, 1.57 times the mean, in the middle.
        turn_time: f64 = 0.8, 0.01..=1000.0;
        /// Time from there until it turns back [s].
        turn_stay: f64 = 0.35, 0.0..=1000.0;
    }
}

section! {
    /// Exposure and shutter, the rule of the paper's appendix.
    exposure: ExposureSpec {
        /// The camera response: "reinhard" (x / (1 + x))^(1/2.2), "srgb" (clips at 1), or
        /// "measured" (toe, soft shoulder, a little different in each channel).
        response: Response = Response::Reinhard;
        /// Whether exposure follows the scene: the median grey of the picture would be half of
        /// white. If not, the first frame's exposure stays.
        automatic: bool = true;
        /// Frames over which automatic exposure follows: EV += (raw - EV) / this.
        smoothing: f64 = 3.0, 1.0..=1000.0;
        /// Shortest open share of the frame interval; SV = a 2^EV + b reaches it.
        shutter_minimum: f64 = 0.1, 0.0..=1.0;
        /// Longest open share of the frame interval. A sequence of one exposure takes the middle.
        shutter_maximum: f64 = 1.0, 0.0..=1.0;
    }
}

section! {
    /// Drift of the white balance; green stays.
    white_balance: WhiteBalanceSpec {
        /// Largest departure of red and of blue, in opposite directions [stops]; 0 is none.
        drift: f64 = 0.0, 0.0..=3.0;
        /// Time of a full swing [s].
        period: f64 = 4.0, 0.1..=1000.0;
    }
}

section! {
    /// Noise of the colour sensor, before the response: variance = read^2 + shot * exposed value.
    noise: NoiseSpec {
        /// Standard deviation of black.
        read: f64 = 0.0015, 0.0..=1.0;
        /// Variance of an exposed value of 1.
        shot: f64 = 0.0003, 0.0..=1.0;
    }
}

section! {
    /// The depth sensor.
    depth: DepthSpec {
        /// Whether depth has the noise, steps and holes of a first-generation Kinect.
        kinect: bool = false;
        /// Depth beyond this is invalid [m].
        maximum: f64 = 12.0, 0.1..=13.1;
    }
}

section! {
    /// Optional outputs.
    output: OutputSpec {
        /// Radiance (EXR) of every n-th frame; 0 writes none.
        hdr_every: usize = 1, 0.0..=100_000.0;
        /// Whether the sharp pictures are written.
        sharp: bool = true;
    }
}
