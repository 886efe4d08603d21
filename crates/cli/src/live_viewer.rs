//! The map and path of now in a browser (`--live`): a page on loopback that follows the run.

use crate::console::print_status;
use crate::failure::Failure;
use i2slam::dataset::Sequence;
use i2slam::formation::{CameraResponse, NodeSpacing, ShutterPoses, StartCurve, Vignetting};
use i2slam::geometry::{Camera, Pose, StampedPose};
use i2slam::{Config, FrameEstimate, Map, Reconstruction, UnitOfLength};
use i2slam_result::{FrameFiles, ViewerPage};
use std::net::Ipv4Addr;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tiny_http::{Header, Method, Request, Response, Server};

/// Least time between two copies of the map while a page asks for them, and while none does.
const PAUSE: Duration = Duration::from_secs(2);
const UNWATCHED_PAUSE: Duration = Duration::from_secs(10);
/// A copy may take this part of the time until the next.
const COPY_SHARE: u32 = 20;
/// Time without a question after which a page counts as closed.
const SILENCE: Duration = Duration::from_secs(5);
/// Time that pages get for the last map when the run has ended.
const LAST_MAP: Duration = Duration::from_secs(3);

/// Server of a page with the map of now, on the loopback interface alone. It never changes the run.
pub(crate) struct LiveViewer {
    server: Arc<Server>,
    shown: Arc<Mutex<Shown>>,
    thread: Option<JoinHandle<()>>,
}

/// Numbers and files of the frames of a sequence.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceFrames {
    files: FrameFiles,
    /// Time stamps [s], in order, with the number of each frame.
    numbers: Vec<(f64, usize)>,
}

impl SequenceFrames {
    /// Frames of a sequence in the folder `dataset`.
    pub(crate) fn of(sequence: &Sequence, dataset: &Path) -> Self {
        let numbers = sequence.entries.iter().map(|entry| (entry.timestamp, entry.index)).collect();
        Self { files: FrameFiles::of(sequence, dataset), numbers }
    }

    fn number(&self, timestamp: f64) -> Option<usize> {
        let place = self.numbers.binary_search_by(|(stamp, _)| stamp.total_cmp(&timestamp)).ok()?;
        Some(self.numbers[place].1)
    }
}

/// State that pages show.
struct Shown {
    title: String,
    frames: Arc<SequenceFrames>,
    status: String,
    /// A copy of the run; without one there is nothing to show yet.
    run: Option<Arc<Reconstruction>>,
    /// Poses as they were known when their frames came.
    poses: Vec<StampedPose>,
    /// Changes with every copy.
    version: u64,
    /// Of the last map that a page took.
    taken: u64,
    /// When the next copy is due.
    due: Instant,
    /// When a page asked last.
    asked: Option<Instant>,
    ended: bool,
}

impl LiveViewer {
    /// Starts to listen on a port of the loopback interface, a free one for 0, and prints the address.
    pub(crate) fn start(port: u16) -> Result<Self, Failure> {
        let server = Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| {
            Failure::Usage(format!(
                "--live={port}: cannot listen there ({error}); --live alone takes a free port"
            ))
        })?;
        let server = Arc::new(server);
        let address = server.server_addr();
        print_status(&format!("live view: http://{address}/ (this machine alone)"));
        let shown = Arc::new(Mutex::new(Shown::new()));
        let (asked, known) = (Arc::clone(&server), Arc::clone(&shown));
        let thread = thread::spawn(move || {
            asked.incoming_requests().for_each(|request| answer(request, &known));
        });
        Ok(Self { server, shown, thread: Some(thread) })
    }

    fn shown(&self) -> MutexGuard<'_, Shown> {
        lock(&self.shown)
    }

    /// Names the run, whose frames are of a camera.
    pub(crate) fn begin(
        &self,
        title: &str,
        config: &Config,
        (camera, frames): (&Camera<f64>, SequenceFrames),
    ) {
        let mut shown = self.shown();
        title.clone_into(&mut shown.title);
        shown.frames = Arc::new(frames);
        if shown.run.is_none() {
            shown.show(without_frames(config, camera));
        }
    }

    /// Sets the words for the work of now.
    pub(crate) fn set_status(&self, status: String) {
        self.shown().status = status;
    }

    /// A pose as it is known when its frame has come.
    pub(crate) fn add_pose(&self, pose: &StampedPose) {
        let mut shown = self.shown();
        if !shown.has_map_of_its_own() {
            shown.poses.push(*pose);
            shown.version += 1;
        }
    }

    /// Shows the map of now, if a copy is due.
    pub(crate) fn show(&self, current: &dyn Fn() -> Reconstruction) {
        let started = Instant::now();
        if started < self.shown().due {
            return;
        }
        // A run waits for the copy, but not for pages.
        let run = current();
        let now = Instant::now();
        let mut shown = self.shown();
        let pause = if shown.is_watched(now) { PAUSE } else { UNWATCHED_PAUSE };
        shown.due = now + pause.max(COPY_SHARE * (now - started));
        shown.show_map(run);
    }

    /// Shows the last map, and gives pages that are open time to take it.
    pub(crate) fn end(&self, run: &Reconstruction, status: String) {
        let mut shown = self.shown();
        shown.show_map(run.clone());
        (shown.status, shown.ended) = (status, true);
        drop(shown);
        let until = Instant::now() + LAST_MAP;
        let is_awaited = || {
            let (shown, now) = (self.shown(), Instant::now());
            shown.is_watched(now) && shown.taken < shown.version && now < until
        };
        while is_awaited() {
            thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for LiveViewer {
    fn drop(&mut self) {
        self.server.unblock();
        if let Some(thread) = self.thread.take() {
            // It ends with the server; a panic there has shown itself.
            thread.join().ok();
        }
    }
}

impl Shown {
    fn new() -> Self {
        Self {
            title: String::new(),
            frames: Arc::default(),
            status: "Reading the sequence".to_owned(),
            run: None,
            poses: Vec::new(),
            version: 0,
            taken: 0,
            due: Instant::now(),
            asked: None,
            ended: false,
        }
    }

    fn show(&mut self, run: Reconstruction) {
        self.run = Some(Arc::new(run));
        self.version += 1;
    }

    fn show_map(&mut self, mut run: Reconstruction) {
        if let Map::HashGrid(_) = run.map {
            // A page draws no hash grid: its path alone.
            run.map = Map::default();
        }
        self.show(run);
        if self.has_map_of_its_own() {
            self.poses.clear();
        }
    }

    /// True if a map by colour alone is shown, which has a unit of its own.
    fn has_map_of_its_own(&self) -> bool {
        let run = self.run.as_ref().filter(|run| !run.frames.is_empty());
        run.is_some_and(|run| run.config.is_rgb())
    }

    fn is_watched(&self, now: Instant) -> bool {
        self.asked.is_some_and(|asked| now - asked < SILENCE)
    }
}

/// A copy of a run with the frames that were tracked and not mapped yet.
fn with_later_poses(
    run: &Reconstruction,
    (poses, frames): (&[StampedPose], &SequenceFrames),
) -> Reconstruction {
    let mut run = run.clone();
    let mapped = run.frames.last().map_or(f64::NEG_INFINITY, |frame| frame.timestamp);
    let still = run.virtual_frame(0, Pose::identity());
    let first = run.frames.last().map_or(0, |frame| frame.index + 1);
    let later = poses.iter().filter(|pose| pose.timestamp > mapped).enumerate();
    run.frames.extend(later.map(|(i, pose)| {
        let shutter = ShutterPoses::still(pose.world_from_camera);
        let timestamp = pose.timestamp;
        let index = frames.number(timestamp).unwrap_or(first + i);
        FrameEstimate { index, timestamp, shutter, ..still.clone() }
    }));
    run
}

/// A run before its first frame.
fn without_frames(config: &Config, camera: &Camera<f64>) -> Reconstruction {
    Reconstruction {
        config: config.clone(),
        camera: *camera,
        frames: Vec::new(),
        online_trajectory: Vec::new(),
        map: Map::default(),
        responses: vec![CameraResponse::new(1, StartCurve::Srgb, NodeSpacing::Uniform)],
        vignetting: Vignetting::default(),
        rolling_shutter_readout: 0.0,
        unit_of_length: UnitOfLength::of_pictures(config),
    }
}

fn lock(shown: &Mutex<Shown>) -> MutexGuard<'_, Shown> {
    shown.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Answers a browser. One that has gone away meanwhile hears nothing.
fn answer(request: Request, shown: &Mutex<Shown>) {
    let url = request.url().to_owned();
    let (path, query) = url.split_once('?').unwrap_or((&url, ""));
    let (code, kind, text) = match path {
        // Other names lead here where a page of elsewhere wants to read the map.
        _ if !is_of_this_machine(&request) => (403, PLAIN, "Only for this machine.\n".to_owned()),
        _ if *request.method() != Method::Get => (405, PLAIN, "Only GET.\n".to_owned()),
        "/" => (200, "text/html; charset=utf-8", page(shown)),
        "/update" => (200, "application/json", update(shown, version_in(query))),
        _ => (404, PLAIN, "There is nothing here.\n".to_owned()),
    };
    let header = |name: &str, value: &str| Header::from_bytes(name, value).ok();
    let headers = [header("Content-Type", kind), header("Cache-Control", "no-store")];
    let mut response = Response::from_string(text).with_status_code(code);
    headers.into_iter().flatten().for_each(|header| response.add_header(header));
    request.respond(response).ok();
}

const PLAIN: &str = "text/plain; charset=utf-8";

/// True if the browser asks for this machine by a name of loopback.
fn is_of_this_machine(request: &Request) -> bool {
    let host = request.headers().iter().find(|header| header.field.equiv("Host"));
    let name = host.map(|header| header.value.as_str());
    let name = name.map(|host| host.rsplit_once(':').map_or(host, |(name, _)| name));
    matches!(name, Some("localhost" | "127.0.0.1"))
}

fn version_in(query: &str) -> u64 {
    let value = query.split('&').find_map(|pair| pair.strip_prefix("after="));
    value.and_then(|value| value.parse().ok()).unwrap_or(0)
}

fn page(shown: &Mutex<Shown>) -> String {
    let (title, run) = {
        let shown = lock(shown);
        (shown.title.clone(), shown.run.clone())
    };
    // The page asks for poses and map at once.
    let page = run.map(|run| {
        let empty = without_frames(&run.config, &run.camera);
        ViewerPage::of_run(&title, &empty, &FrameFiles::default()).live_html()
    });
    match page {
        Some(Ok(page)) => page,
        Some(Err(reason)) => format!("{WAITING}<p>{reason}"),
        None => format!("{WAITING}<p>Waiting for the first frame…"),
    }
}

/// Beginning of a page that asks again in a second.
const WAITING: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><link rel=\"icon\" href=\"data:,\">\
    <meta http-equiv=\"refresh\" content=\"1\"><title>i2slam</title>";

/// JSON of what is new after a version.
fn update(shown: &Mutex<Shown>, after: u64) -> String {
    let (title, frames, mut status, run, version, ended) = {
        let mut shown = lock(shown);
        shown.asked = Some(Instant::now());
        let run = shown.run.clone().filter(|_| shown.version != after);
        let run = run.map(|run| (run, shown.poses.clone()));
        let (title, frames) = (shown.title.clone(), Arc::clone(&shown.frames));
        (title, frames, shown.status.clone(), run, shown.version, shown.ended)
    };
    // Beyond the last mapped frame there is little to see.
    let latest = run.as_ref().and_then(|(run, _)| Some(run.frames.last()?.index));
    let latest = serde_json::Value::from(latest);
    let run = run.map(|(run, poses)| with_later_poses(&run, (&poses, &frames)));
    let state = match run.map(|run| ViewerPage::of_run(&title, &run, &frames.files).update()) {
        Some(Ok(state)) => state,
        Some(Err(reason)) => {
            status = format!("{status}: {reason}");
            "null".to_owned()
        }
        None => "null".to_owned(),
    };
    lock(shown).taken = version;
    let status = serde_json::Value::from(status);
    format!(
        r#"{{"version":{version},"status":{status},"ended":{ended},"latest":{latest},"state":{state}}}"#
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpStream;

    fn camera() -> Camera<f64> {
        Camera { width: 4, height: 3, fx: 4.0, fy: 4.0, cx: 1.5, cy: 1.0 }
    }

    fn get(viewer: &LiveViewer, path: &str, host: &str) -> String {
        let mut stream =
            TcpStream::connect(viewer.server.server_addr().to_string()).expect("a connection");
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("a request");
        let mut text = String::new();
        stream.read_to_string(&mut text).expect("an answer");
        text
    }

    fn json(answer: &str) -> serde_json::Value {
        let body = answer.split_once("\r\n\r\n").expect("a body").1;
        serde_json::from_str(&body[body.find('{').expect("JSON")..=body.rfind('}').expect("JSON")])
            .expect("JSON")
    }

    #[test]
    fn pages_see_poses_then_the_map_and_its_end() {
        let viewer = LiveViewer::start(0).expect("a free port");
        assert!(get(&viewer, "/", "localhost").contains("Waiting for the first frame"));
        let frames = SequenceFrames {
            files: [(8, "IMG_1234.jpg".to_owned())].into_iter().collect(),
            numbers: vec![(0.25, 6), (0.5, 8)],
        };
        viewer.begin("a clip", &Config::default(), (&camera(), frames));
        assert!(get(&viewer, "/", "127.0.0.1:80").contains("update?after="));
        let pose = Pose::identity();
        viewer.add_pose(&StampedPose { timestamp: 0.5, world_from_camera: pose });
        let first = json(&get(&viewer, "/update?after=0", "localhost"));
        let frames = first["state"]["scene"]["frames"].as_array().expect("frames");
        assert_eq!((frames.len(), &frames[0]["name"]), (1, &"8, IMG_1234.jpg".into()));
        let path = format!("/update?after={}", first["version"]);
        assert!(json(&get(&viewer, &path, "localhost"))["state"].is_null());
        viewer.show(&|| without_frames(&Config::default(), &camera()));
        // Not due yet.
        viewer.show(&|| unreachable!("a copy that is not due"));
        let second = json(&get(&viewer, &path, "localhost"));
        assert_eq!(second["state"]["scene"]["frames"].as_array().map(Vec::len), Some(1));
        assert_eq!(second["ended"], false);
        viewer.set_status("done".to_owned());
        let asking = thread::scope(|scope| {
            let asking = scope.spawn(|| {
                thread::sleep(Duration::from_millis(200));
                json(&get(&viewer, &format!("/update?after={}", second["version"]), "localhost"))
            });
            viewer.end(&without_frames(&Config::default(), &camera()), "ended".to_owned());
            asking.join().expect("an answer")
        });
        assert_eq!((&asking["status"], &asking["ended"]), (&"ended".into(), &true.into()));
    }

    #[test]
    fn other_machines_names_and_ports_in_use_are_refused() {
        let viewer = LiveViewer::start(0).expect("a free port");
        for (path, host, code) in [
            ("/", "example.org", "403"),
            ("/update", "192.168.0.2:80", "403"),
            ("/etc/passwd", "localhost", "404"),
        ] {
            let answer = get(&viewer, path, host);
            assert!(answer.starts_with(&format!("HTTP/1.1 {code}")), "{answer}");
        }
        let port = viewer.server.server_addr().to_ip().expect("an address").port();
        let failure = LiveViewer::start(port).err().expect("a port in use");
        let message = failure.message().unwrap_or_default();
        assert!(message.contains(&format!("--live={port}: cannot listen")), "{message}");
    }
}
