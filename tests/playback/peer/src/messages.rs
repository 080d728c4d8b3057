// SPDX-License-Identifier: Apache-2.0
//! Messages, field by field as CDR has them. Arrays longer than serde knows are two, one after the other.

#![allow(dead_code)] // fields are there for their places

use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Stamp {
    pub sec: i32,
    pub nanosec: u32,
}

#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Header {
    pub stamp: Stamp,
    pub frame_id: String,
}

#[derive(Debug, Deserialize)]
pub struct PointField {
    name: String,
    offset: u32,
    datatype: u8,
    count: u32,
}

#[derive(Debug, Deserialize)]
pub struct PointCloud2 {
    pub header: Header,
    height: u32,
    width: u32,
    fields: Vec<PointField>,
    is_bigendian: bool,
    point_step: u32,
    row_step: u32,
    pub data: Vec<u8>,
    is_dense: bool,
}

#[derive(Debug, Deserialize)]
pub struct Image {
    header: Header,
    height: u32,
    width: u32,
    encoding: String,
    is_bigendian: u8,
    step: u32,
    pub data: Vec<u8>,
}

#[derive(Debug, Deserialize)]
pub struct Imu {
    header: Header,
    orientation: [f64; 4],
    orientation_covariance: [f64; 9],
    angular_velocity: [f64; 3],
    angular_velocity_covariance: [f64; 9],
    pub linear_acceleration: [f64; 3],
    linear_acceleration_covariance: [f64; 9],
}

type Covariance = ([f64; 18], [f64; 18]);

const UNKNOWN: Covariance = ([0.0; 18], [0.0; 18]);

#[derive(Debug, Serialize)]
pub struct Odometry {
    header: Header,
    child_frame_id: String,
    position: [f64; 3],
    orientation: [f64; 4],
    pose_covariance: Covariance,
    twist: [f64; 6],
    twist_covariance: Covariance,
}

impl Odometry {
    /// Returns the odometry of something that has moved so far ahead, m.
    pub fn at(header: Header, ahead: f64) -> Self {
        Self {
            header,
            child_frame_id: "base".into(),
            position: [ahead, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            pose_covariance: UNKNOWN,
            twist: [0.0; 6],
            twist_covariance: UNKNOWN,
        }
    }
}
