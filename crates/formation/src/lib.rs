#![doc = include_str!("../README.md")]

pub mod auto_exposure;
pub mod blur_estimate;
pub mod form;
pub mod gauge;
pub mod reproject;
pub mod response_estimate;
pub mod shutter;
pub mod tone;
pub mod trajectory_loss;
pub mod vignetting;

pub use auto_exposure::{
    AutoExposure, AutoExposureFit, ExposureFollower, ExposureSample, Meter, Metering,
};
pub use form::{Formation, accumulate, scale_into};
pub use gauge::ResponsePrior;
pub use response_estimate::LogResponse;
pub use shutter::{
    CentreVelocity, Quadrature, ShutterPoses, ShutterTangent, VirtualCamera, row_place,
};
pub use tone::{
    CameraResponse, CurveGradient, FrameTone, FrameToneGradient, NodeSpacing, ResponseCurve,
    StartCurve, WhiteBalanceModel,
};
pub use trajectory_loss::{TrajectoryGradient, TrajectoryLoss, TrajectoryPair, TrajectoryScale};
pub use vignetting::Vignetting;
