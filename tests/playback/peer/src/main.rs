// SPDX-License-Identifier: Apache-2.0
//! Takes clouds, images and IMU, and gives each cloud a pose that lies 1 m per second ahead. What came is
//! counted, with the sum of its contents' checksums, in counts.json.

mod messages;

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::sync::{mpsc, Arc, Mutex};
use std::time::Duration;
use std::{env, fs, thread};

use futures::StreamExt;
use messages::{Header, Image, Imu, Odometry, PointCloud2};
use ros2_client::qos::History;
use ros2_client::{Context, MessageTypeName, Name, Node, NodeName, NodeOptions, QosProfile};
use rustdds::{DomainParticipantBuilder, Topic};
use serde::de::DeserializeOwned;

type Counts = Arc<Mutex<BTreeMap<&'static str, (u64, u64)>>>;

const EPOCH: f64 = 1_600_000_000.0;

fn topic(node: &Node, namespace: &str, name: &str, kind: (&str, &str)) -> Topic {
    let kind = MessageTypeName::new(kind.0, kind.1);
    node.create_topic(&Name::new(namespace, name).unwrap(), kind, &reliable()).unwrap()
}

/// Reliable, with room for all that is played. (RustDDS keeps 64 messages of a topic that keeps all.)
fn reliable() -> QosProfile {
    QosProfile::publisher_default().history(History::KeepLast { depth: 4096 })
}

/// Counts the messages of a topic in a thread of its own, and hands each to a function that returns what to
/// sum.
fn hear<M, F>(node: &mut Node, topic: &Topic, counts: &Counts, name: &'static str, mut take: F)
where
    M: DeserializeOwned + Send + 'static,
    F: FnMut(M) -> u32 + Send + 'static,
{
    let subscription = node.create_subscription::<M>(topic, Some(reliable())).unwrap();
    let counts = Arc::clone(counts);
    thread::spawn(move || {
        let mut stream = Box::pin(subscription.async_stream());
        while let Some(found) = futures::executor::block_on(stream.next()) {
            match found {
                Ok((message, _)) => {
                    let sum = u64::from(take(message));
                    let mut counts = counts.lock().unwrap();
                    let known = counts.entry(name).or_default();
                    *known = (known.0 + 1, known.1 + sum);
                }
                Err(error) => eprintln!("{name}: {error:?}"),
            }
        }
    });
}

fn seconds(header: &Header) -> f64 {
    f64::from(header.stamp.sec) - EPOCH + f64::from(header.stamp.nanosec) / 1e9
}

fn main() {
    let domain = env::var("ROS_DOMAIN_ID").map_or(0, |text| text.parse().unwrap());
    let participant = DomainParticipantBuilder::new(domain)
        .with_only_networks([Ipv4Addr::LOCALHOST])
        .build()
        .unwrap();
    let context = Context::from_domain_participant(participant).unwrap();
    let mut node = context.new_node(NodeName::new("/", "peer").unwrap(), NodeOptions::new()).unwrap();
    let spinner = node.spinner().unwrap();
    thread::spawn(|| futures::executor::block_on(spinner.spin()));

    let counts = Counts::default();
    let poses = topic(&node, "/peer", "poses", ("nav_msgs", "Odometry"));
    let poses = node.create_publisher::<Odometry>(&poses, Some(reliable())).unwrap();
    let points = topic(&node, "/", "points", ("sensor_msgs", "PointCloud2"));
    hear(&mut node, &points, &counts, "clouds", move |cloud: PointCloud2| {
        let sum = crc32fast::hash(&cloud.data);
        let ahead = seconds(&cloud.header);
        poses.publish(Odometry::at(cloud.header, ahead)).unwrap();
        sum
    });
    let images = topic(&node, "/left", "image_raw", ("sensor_msgs", "Image"));
    hear(&mut node, &images, &counts, "images", |image: Image| crc32fast::hash(&image.data));
    let imu = topic(&node, "/", "imu", ("sensor_msgs", "Imu"));
    hear(&mut node, &imu, &counts, "imu", |imu: Imu| {
        let [a, b, c] = imu.linear_acceleration;
        let raw: Vec<u8> = [a, b, c].iter().flat_map(|value| value.to_le_bytes()).collect();
        crc32fast::hash(&raw)
    });

    let (tell, told) = mpsc::channel();
    ctrlc::set_handler(move || tell.send(()).unwrap()).unwrap();
    told.recv().unwrap();
    // What was played to it may still be on its way on a busy machine.
    let mut before = None;
    while before.as_ref() != Some(&*counts.lock().unwrap()) {
        before = Some(counts.lock().unwrap().clone());
        thread::sleep(Duration::from_secs(2));
    }
    let lines: Vec<String> = counts
        .lock()
        .unwrap()
        .iter()
        .map(|(name, (count, sum))| format!("\"{name}\": {count}, \"{name}Sum\": {sum}"))
        .collect();
    let run = env::var("SLAMHIVE_RUN").unwrap();
    fs::write(format!("{run}/output/counts.json"), format!("{{{}}}\n", lines.join(", "))).unwrap();
}
