use super::*;
use i2slam_check::noise;
use std::f64::consts::{LN_2, TAU};

const RATE: f64 = 30.0;

/// What meters read of a camera that looks from dark to bright and back, past a lamp that counts more in
/// means than in the median.
fn views(count: usize) -> Vec<Metering> {
    let view = |i: usize| {
        let t = i as f64 / RATE;
        let wall = LN_2 * (1.2 * (TAU * t / 2.1).sin() + f64::from(u8::from(i % 50 > 30)));
        let lamp = LN_2 * (1.5 * (TAU * t / 0.9).cos() + 2.0);
        Metering::new(|meter| match meter {
            Meter::Median => wall,
            Meter::PictureMean => 0.8 * wall + 0.2 * lamp,
            Meter::Mean => 0.5 * wall + 0.5 * lamp,
            Meter::CentreWeighted => lamp,
        })
    };
    (0..count).map(view).collect()
}

fn camera(meter: Meter, slope: f64, time_constant: f64) -> AutoExposure {
    AutoExposure { meter, offset: 0.4, slope, time_constant, range: [-9.0, 9.0] }
}

/// Frames of a camera whose exposures are known to a deviation of a tenth of a stop.
fn frames(camera: AutoExposure, count: usize) -> Vec<ExposureSample> {
    let (mut follower, noise) = (camera.follow(), noise(5, count));
    let frame = |(i, metering): (usize, Metering)| {
        let time = 12.0 + i as f64 / RATE;
        let due = follower.next(time, Some(&metering)).unwrap_or(f64::NAN);
        // Uniform in ±1, of deviation 1/√3.
        let log_exposure = due + 0.1 * LN_2 * 3.0_f64.sqrt() * noise[i];
        ExposureSample { time, metering: Some(metering), log_exposure }
    };
    views(count).into_iter().enumerate().map(frame).collect()
}

#[test]
fn a_camera_is_found_from_its_frames() {
    for (meter, slope, time_constant) in
        [(Meter::Median, -1.0, 0.08), (Meter::CentreWeighted, -0.6, 0.2), (Meter::Mean, -0.9, 0.0)]
    {
        let true_camera = camera(meter, slope, time_constant);
        let fit = AutoExposureFit::new(&frames(true_camera, 150)).expect("enough frames");
        let found = fit.better_than_constant().expect("exposure follows light");
        assert_eq!(found.meter, meter);
        assert!((found.slope - slope).abs() < 0.05, "{found:?}");
        assert!((found.offset - true_camera.offset).abs() < 0.05, "{found:?}");
        // Time constants are tried in steps of half as much again, from a third of an interval on.
        let off = (found.time_constant - time_constant).abs();
        assert!(off < 0.3 * time_constant + 0.5 / RATE, "{found:?}");
        assert!(fit.error < 0.12 * LN_2 && fit.constant_error > 2.5 * fit.error, "{fit:?}");
    }
}

#[test]
fn frames_with_absurd_exposures_are_no_harm() {
    let true_camera = camera(Meter::Median, -1.0, 0.1);
    let mut frames = frames(true_camera, 120);
    for i in [3, 40, 41, 42, 90] {
        frames[i].log_exposure += 6.0;
    }
    frames[7].log_exposure = f64::NAN;
    frames[8].metering = None;
    let found = AutoExposureFit::new(&frames).and_then(|fit| fit.better_than_constant());
    let found = found.expect("exposure follows light");
    assert!((found.slope + 1.0).abs() < 0.08 && (found.offset - 0.4).abs() < 0.08, "{found:?}");
}

#[test]
fn a_constant_stays_where_light_explains_nothing() {
    let better = |frames: &[ExposureSample]| {
        AutoExposureFit::new(frames).and_then(|fit| fit.better_than_constant())
    };
    // A fixed exposure, known to a tenth of a stop.
    assert_eq!(better(&frames(camera(Meter::Median, 0.0, 0.0), 100)), None);
    // Exposures that wander by themselves.
    let mut wander = frames(camera(Meter::Median, 0.0, 0.0), 100);
    for (i, frame) in wander.iter_mut().enumerate() {
        frame.log_exposure += LN_2 * (i as f64 * 0.13).sin();
    }
    assert_eq!(better(&wander), None);
    // Longer where it is brighter is no camera.
    assert_eq!(better(&frames(camera(Meter::Median, 1.0, 0.1), 100)), None);
    // More than every view equally bright is no camera either, but nearest to one that does that.
    let too_much = better(&frames(camera(Meter::Median, -1.5, 0.0), 100));
    assert!(too_much.is_none_or(|found| found.slope == -1.0), "{too_much:?}");
    // Light varies by a fiftieth of a stop, and exposure with it.
    let mut even = frames(camera(Meter::Median, -1.0, 0.0), 100);
    for (i, frame) in even.iter_mut().enumerate() {
        let light = 0.02 * LN_2 * (i as f64 * 0.13).sin();
        (frame.metering, frame.log_exposure) = (Some(Metering::new(|_| light)), -light);
    }
    assert_eq!(better(&even), None);
    assert_eq!(better(&frames(camera(Meter::Median, -1.0, 0.1), 9)), None);
    assert_eq!(better(&[]), None);
}

#[test]
fn times_that_do_not_rise_are_no_harm() {
    let mut frames = frames(camera(Meter::Median, -1.0, 0.0), 60);
    frames.iter_mut().for_each(|frame| frame.time = 3.0);
    let fit = AutoExposureFit::new(&frames).expect("enough frames");
    assert!(fit.better_than_constant().is_some_and(|found| (found.slope + 1.0).abs() < 0.05));
}

#[test]
fn exposures_stay_within_the_widened_range_of_the_frames() {
    let mut frames = frames(camera(Meter::Median, -1.0, 0.05), 100);
    let exposures = frames.iter().map(|frame| frame.log_exposure);
    let (least, most) = exposures.fold((9.0_f64, -9.0_f64), |e, v| (e.0.min(v), e.1.max(v)));
    // Two frames whose exposure was not found.
    (frames[30].log_exposure, frames[31].log_exposure) = (12.0, -12.0);
    let fit = AutoExposureFit::new(&frames).expect("enough frames");
    let found = fit.better_than_constant().expect("exposure follows light");
    let [longest, shortest] = [-20.0, 20.0].map(|light| found.settled(&Metering::new(|_| light)));
    let half = 0.5 * LN_2;
    assert!(longest <= most + half && longest > most, "{longest} {most}");
    assert!(shortest >= least - half && shortest < least, "{shortest} {least}");
}

#[test]
fn a_flight_begins_settled_and_follows_without_a_jump() {
    let camera = camera(Meter::Median, -1.0, 0.1);
    let [dark, bright] = [0.0, 2.0].map(|light| Metering::new(|_| light));
    for rate in [30.0, 120.0] {
        let mut follower = camera.follow();
        assert_eq!(follower.next(0.0, None), None);
        let mut next = |i: f64, view| follower.next(i / rate, view).unwrap_or(f64::NAN);
        assert_eq!(next(0.0, Some(&dark)), camera.settled(&dark));
        assert_eq!(next(1.0, None), camera.settled(&dark));
        let (mut last, mut at_time_constant) = (camera.settled(&dark), f64::NAN);
        for i in 2..200 {
            let now = next(f64::from(i), Some(&bright));
            // Two views in turn change exposure by no more than the low pass lets through.
            let most = 2.0 * (1.0 - (-2.0 / (0.1 * rate)).exp());
            assert!(now <= last && last - now <= most + 1e-12, "{i} {last} {now}");
            // Since the last view seen, at 0.
            if (f64::from(i) / rate - 0.1).abs() < 1e-9 {
                at_time_constant = last - now + (camera.settled(&dark) - last);
            }
            last = now;
        }
        // After τ the step is done but for a share of 1/e, whatever the rate.
        let due = 2.0 * (1.0 - (-1.0_f64).exp());
        assert!((at_time_constant - due).abs() < 1e-9, "{at_time_constant} {due}");
        assert!((last - camera.settled(&bright)).abs() < 0.01);
    }
}
