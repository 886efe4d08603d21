//! Jobs that wait for the map: any number, whose pictures may leave memory.

use super::queue::Job;
use i2slam_geometry::Image;
use i2slam_storage::{ScratchStore, Storable, Stored, append_floats, floats};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A queue between the thread that tracks and the one that maps.
pub(super) struct Backlog {
    state: Mutex<State>,
    changed: Condvar,
    scratch: Arc<ScratchStore>,
}

#[derive(Default)]
struct State {
    jobs: VecDeque<StoredJob>,
    /// True once no job comes, or nobody takes one.
    is_closed: bool,
}

/// A job whose pictures may leave memory.
pub(super) struct StoredJob {
    /// Without pictures.
    pub(super) job: Job,
    pictures: Stored<Pictures>,
    /// The picture of every place for one.
    places: Vec<usize>,
}

/// The pictures of a job, each once.
struct Pictures(Vec<Arc<Image<f32>>>);

impl Backlog {
    pub(super) fn new(scratch: Arc<ScratchStore>) -> Self {
        Self { state: Mutex::default(), changed: Condvar::new(), scratch }
    }

    /// Adds a job.
    pub(super) fn send(&self, job: Job) {
        let job = StoredJob::new(job, &self.scratch);
        let mut state = self.state();
        if !state.is_closed {
            state.jobs.push_back(job);
            self.changed.notify_all();
        }
    }

    /// The first job, once there is one; `None` after the last.
    pub(super) fn receive(&self) -> Option<Job> {
        let mut state = self.state();
        loop {
            if let Some(job) = state.jobs.pop_front() {
                self.changed.notify_all();
                drop(state);
                return Some(job.with_pictures());
            }
            if state.is_closed {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Number of jobs that wait.
    pub(super) fn len(&self) -> usize {
        self.state().jobs.len()
    }

    /// Waits until at most so many jobs do.
    pub(super) fn wait_for(&self, jobs: usize) {
        let mut state = self.state();
        while state.jobs.len() > jobs && !state.is_closed {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Ends the queue: jobs in it are still received.
    pub(super) fn close(&self) {
        self.state().is_closed = true;
        self.changed.notify_all();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl StoredJob {
    pub(super) fn new(mut job: Job, scratch: &Arc<ScratchStore>) -> Self {
        let none = Arc::new(Image::new(0, 0, 0));
        let (mut pictures, mut places): (Vec<Arc<Image<f32>>>, _) = (Vec::new(), Vec::new());
        for place in job.pictures() {
            let picture = std::mem::replace(place, Arc::clone(&none));
            let known = pictures.iter().position(|known| Arc::ptr_eq(known, &picture));
            places.push(known.unwrap_or(pictures.len()));
            pictures.extend(known.is_none().then_some(picture));
        }
        Self { job, pictures: scratch.insert(Pictures(pictures)), places }
    }

    pub(super) fn with_pictures(mut self) -> Job {
        let pictures = self.pictures.get();
        for (place, picture) in self.job.pictures().into_iter().zip(&self.places) {
            *place = Arc::clone(&pictures.0[*picture]);
        }
        self.job
    }
}

impl Storable for Pictures {
    /// Width, height and channels of each.
    type Shape = Vec<[usize; 3]>;

    fn shape(&self) -> Self::Shape {
        self.0.iter().map(|image| [image.width, image.height, image.channels]).collect()
    }

    fn memory(&self) -> usize {
        self.0.iter().map(|image| size_of_val(&*image.data)).sum()
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.0.iter().for_each(|image| append_floats(bytes, &image.data));
    }

    fn read(shape: &Self::Shape, bytes: &[u8]) -> Self {
        let mut rest = bytes;
        let image = |&[width, height, channels]: &[usize; 3]| {
            let (first, others) = rest.split_at(size_of::<f32>() * width * height * channels);
            rest = others;
            Arc::new(Image { width, height, channels, data: floats(first) })
        };
        Self(shape.iter().map(image).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::super::queue::BetweenJob;
    use super::*;
    use crate::keyframes::PosedKeyframe;
    use i2slam_check::TemporaryFolder;
    use i2slam_dataset::Frame;
    use i2slam_geometry::Pose;
    use i2slam_odometry::MeasuredDepth;

    fn job(number: usize) -> Job {
        let image = |channels| {
            Arc::new(Image::from_fn(6, 4, channels, |k, c, r| {
                (number + 2 * k + 3 * c + 5 * r) as f32
            }))
        };
        let frame = Frame::colour_only(number, number as f64, image(3));
        let posed = PosedKeyframe::from_frame(frame, Pose::identity());
        let measured = MeasuredDepth { depth: image(1), depth_from_colour: Pose::identity() };
        Job::Between(Box::new(BetweenJob { posed, measured, readout: 0.0, steps: number }))
    }

    #[test]
    fn jobs_keep_order_and_pictures() {
        let folder = TemporaryFolder::new("backlog");
        let backlog = Backlog::new(ScratchStore::new(1000, folder.join("")));
        (0..20).for_each(|number| backlog.send(job(number)));
        assert!(backlog.scratch.file_bytes() > 0 && backlog.scratch.resident_bytes() <= 1000);
        backlog.close();
        for number in 0..20 {
            let (Some(Job::Between(found)), Job::Between(sent)) = (backlog.receive(), job(number))
            else {
                panic!("a frame between keyframes");
            };
            assert_eq!(found.posed.colour, sent.posed.colour);
            assert_eq!(found.measured.depth, sent.measured.depth);
            assert_eq!(found.steps, number);
        }
        assert!(backlog.receive().is_none());
    }

    #[test]
    fn a_sender_waits_for_the_receiver_if_it_wants_to() {
        let backlog = Backlog::new(ScratchStore::in_memory());
        (0..5).for_each(|number| backlog.send(job(number)));
        backlog.wait_for(5);
        std::thread::scope(|scope| {
            scope.spawn(|| (0..3).for_each(|_| drop(backlog.receive())));
            backlog.wait_for(2);
        });
        assert_eq!(backlog.len(), 2);
        // Nobody is waited for who takes no more.
        backlog.close();
        backlog.wait_for(0);
    }
}
