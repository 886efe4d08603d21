//! Output folders that are replaced, extended, refused, and interrupted at any moment.

use super::*;
use crate::output::Place;
use i2slam_check::{TemporaryFolder, names};
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

const CLAIM: Claim<'_> =
    Claim { command: "i2slam run", names: &["map.ply", "renders"], overwrite: true };
const NEW: Claim<'_> = Claim { overwrite: false, ..CLAIM };
const PLACES: [Place; 3] = [Place::Beside, Place::BesideAlone, Place::Inside];

/// Writes a result whose files all hold `text`.
fn write_result(
    path: &Path,
    text: &str,
    pictures: usize,
    place: Place,
) -> Result<Committed, StorageError> {
    let mut folder = OutputFolder::replace_at(path, CLAIM, place)?;
    folder.write_text("map.ply", text)?;
    for i in 0..pictures {
        folder.write_text(&format!("renders/sharp/{i:06}.png"), text)?;
    }
    folder.commit()
}

fn text(path: PathBuf) -> Option<String> {
    fs::read_to_string(path).ok()
}

/// Whether all listed files of a result are as written.
fn is_whole(folder: &Path) -> bool {
    let Some(manifest) = Manifest::of(folder) else { return false };
    let mut files = manifest.files.keys();
    files.all(|name| manifest.state(folder, name) == manifest::FileState::Unchanged)
}

fn refusal<T: std::fmt::Debug>(result: Result<T, StorageError>) -> String {
    match result.expect_err("a refusal") {
        StorageError::Refused { reason, .. } => reason,
        other => panic!("{other}"),
    }
}

#[test]
fn a_result_replaces_the_earlier_one_and_leaves_other_files() {
    for (case, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("replace-{case}"));
        let out = scratch.join("out");
        write_result(&out, "old", 3, place).expect("room");
        assert_eq!(names(&out), [MANIFEST, "map.ply", "renders"]);
        fs::write(out.join("notes.txt"), "mine").expect("room");
        fs::write(out.join("renders/sharp/notes.txt"), "mine").expect("room");
        fs::create_dir_all(out.join("photos/2025")).expect("room");
        fs::write(out.join("photos/2025/a.jpg"), "mine").expect("room");
        #[cfg(unix)]
        std::os::unix::fs::symlink("/nowhere", out.join(".link")).expect("a link");
        let committed = write_result(&out, "new", 1, place).expect("room");
        assert_eq!(committed, Committed { path: out.clone(), displaced: None });
        assert!(is_whole(&out) && text(out.join("map.ply")).as_deref() == Some("new"));
        let visible = names(&out).into_iter().filter(|name| name != ".link").collect::<Vec<_>>();
        assert_eq!(visible, [MANIFEST, "map.ply", "notes.txt", "photos", "renders"]);
        assert_eq!(names(&out.join("renders/sharp")), ["000000.png", "notes.txt"]);
        assert_eq!(text(out.join("photos/2025/a.jpg")).as_deref(), Some("mine"));
        assert!(cfg!(not(unix)) || out.join(".link").is_symlink());
        assert_eq!(names(&scratch.0), ["out"], "nothing is left beside");
    }
}

#[test]
fn files_are_added_to_a_result_and_removed_from_it() {
    for (case, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("extend-{case}"));
        let out = scratch.join("out");
        write_result(&out, "old", 2, place).expect("room");
        fs::write(out.join("notes.txt"), "mine").expect("room");
        fs::write(out.join("renders/sharp/000001.png"), "retouched").expect("room");
        let mut folder =
            OutputFolder::extend_at(&out, "i2slam eval", &[], place).expect("a result");
        folder.write_text("report.html", "page").expect("room");
        folder.write_text("report.html", "later page").expect("room");
        folder.commit().expect("room");
        drop(folder);
        let manifest = Manifest::of(&out).expect("a manifest");
        assert_eq!((manifest.command.as_str(), manifest.files.len()), ("i2slam run", 4));
        assert_eq!(text(out.join("report.html")).as_deref(), Some("later page"));
        assert_eq!(text(out.join("renders/sharp/000001.png")).as_deref(), Some("retouched"));
        let mut folder =
            OutputFolder::extend_at(&out, "i2slam-bench", &[], place).expect("a result");
        folder.remove(|name| name.starts_with("renders/"));
        folder.commit().expect("room");
        drop(folder);
        assert_eq!(names(&out.join("renders/sharp")), ["000001.png"], "the user changed it");
        assert_eq!(names(&out), [MANIFEST, "map.ply", "notes.txt", "renders", "report.html"]);
        assert!(is_whole(&out));
        assert_eq!(names(&scratch.0), ["out"]);
    }
}

#[test]
fn what_is_not_committed_leaves_nothing() {
    for (case, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("drop-{case}"));
        let out = scratch.join("deep/out");
        let folder = OutputFolder::replace_at(&out, NEW, place).expect("a new folder");
        folder.write_text("renders/sharp/000000.png", "x").expect("room");
        let full = folder.write("map.ply", |_| Err(std::io::ErrorKind::StorageFull.into()));
        let message = full.expect_err("full").to_string();
        assert!(message.contains("out/map.ply") && message.contains("no space"), "{message}");
        drop(folder);
        assert!(names(&scratch.0).is_empty());
    }
}

#[test]
fn a_result_that_cannot_be_placed_is_kept_beside() {
    for (case, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("beside-{case}"));
        let out = scratch.join("out");
        write_result(&out, "old", 1, place).expect("room");
        let mut folder = OutputFolder::replace_at(&out, CLAIM, place).expect("an old result");
        folder.write_text("map.ply", "new").expect("room");
        fs::write(out.join("map.ply"), "mine now").expect("room");
        assert!(refusal(folder.commit()).contains("map.ply"));
        let beside = folder.commit_beside("partial").expect("room");
        drop(folder);
        assert_eq!(text(beside.join("map.ply")).as_deref(), Some("new"));
        assert!(is_whole(&beside) && text(out.join("map.ply")).as_deref() == Some("mine now"));
        assert_eq!(text(out.join("renders/sharp/000000.png")).as_deref(), Some("old"));
    }
}

#[test]
fn only_own_unchanged_results_are_replaced() {
    let scratch = TemporaryFolder::new("refuse");
    let (out, file) = (scratch.join("out"), scratch.join("file"));
    fs::write(&file, "").expect("room");
    assert!(refusal(OutputFolder::replace(&file, CLAIM)).contains("is a file"));
    fs::create_dir(&out).expect("room");
    fs::write(out.join(".hidden"), "").expect("room");
    OutputFolder::check(&out, NEW).expect("hidden files do not count");
    fs::write(out.join("notes.txt"), "mine").expect("room");
    assert!(refusal(OutputFolder::replace(&out, NEW)).contains("--overwrite"));
    OutputFolder::check(&out, CLAIM).expect("nothing is in the way");
    fs::write(out.join("map.ply"), "mine").expect("room");
    let message = refusal(OutputFolder::replace(&out, CLAIM));
    assert!(message.contains("map.ply") && message.contains("another folder"), "{message}");
    fs::write(out.join(MANIFEST), "{}").expect("room");
    refusal(OutputFolder::replace(&out, CLAIM));
    assert!(refusal(OutputFolder::extend(&out, "i2slam eval", &[])).contains(MANIFEST));
    for name in [MANIFEST, "map.ply", "notes.txt"] {
        fs::remove_file(out.join(name)).expect("a file");
    }
    write_result(&out, "old", 1, Place::Beside).expect("room");
    assert!(refusal(OutputFolder::check(&out, NEW)).contains("--overwrite"));
    let other = Claim { command: "i2slam synth", ..CLAIM };
    assert!(refusal(OutputFolder::check(&out, other)).contains("`i2slam run` wrote"));
    OutputFolder::check(&out, CLAIM).expect("its own");
    fs::write(out.join("map.ply"), "edited").expect("room");
    assert!(refusal(OutputFolder::check(&out, CLAIM)).contains("map.ply"));
    assert_eq!(names(&out), [".hidden", MANIFEST, "map.ply", "renders"]);
}

#[test]
fn a_manifest_that_leads_out_of_its_folder_is_none() {
    let scratch = TemporaryFolder::new("escape");
    write_result(&scratch.join("out"), "old", 0, Place::Beside).expect("room");
    let path = scratch.join("out").join(MANIFEST);
    let good = fs::read_to_string(&path).expect("a manifest");
    for name in ["../map.ply", "/etc/passwd", "a/../../b", ""] {
        fs::write(&path, good.replace("map.ply", name)).expect("room");
        assert_eq!(Manifest::of(&scratch.join("out")), None, "{name}");
    }
}

#[test]
#[cfg(unix)]
fn no_link_is_followed_out_of_the_folder() {
    use std::os::unix::fs::symlink;
    for (case, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("links-{case}"));
        let (out, photos) = (scratch.join("out"), scratch.join("photos"));
        write_result(&out, "old", 2, place).expect("room");
        fs::create_dir_all(photos.join("sharp")).expect("room");
        fs::write(photos.join("sharp/000000.png"), "old").expect("room");
        fs::remove_dir_all(out.join("renders")).expect("a folder");
        symlink(&photos, out.join("renders")).expect("a link");
        assert!(refusal(write_result(&out, "new", 2, place)).contains("renders"));
        refusal(OutputFolder::extend_at(&out, "i2slam render", &["renders"], place));
        let mut folder = OutputFolder::extend_at(&out, "i2slam render", &[], place).expect("free");
        folder.write_text("renders/sharp/000007.png", "new").expect("room");
        refusal(folder.commit());
        drop(folder);
        assert_eq!(names(&photos.join("sharp")), ["000000.png"]);
        assert_eq!(text(photos.join("sharp/000000.png")).as_deref(), Some("old"));
        fs::remove_file(out.join("renders")).expect("a link");
        symlink("../secret", out.join("map.ply.partial")).expect("a link");
        fs::write(scratch.join("secret"), "mine").expect("room");
        write_result(&out, "new", 2, place).expect("room");
        assert_eq!(text(scratch.join("secret")).as_deref(), Some("mine"));
        // A folder that the user names through a link is that folder.
        symlink(&out, scratch.join("link")).expect("a link");
        write_result(&scratch.join("link"), "newer", 2, place).expect("room");
        assert!(scratch.join("link").is_symlink());
        assert_eq!(text(out.join("map.ply")).as_deref(), Some("newer"));
    }
}

#[test]
fn a_second_process_is_refused_until_the_first_ends() {
    let scratch = TemporaryFolder::new("busy");
    let first = OutputFolder::replace(&scratch.join("out"), CLAIM).expect("free");
    let second = OutputFolder::replace(&scratch.join("out"), CLAIM);
    assert!(matches!(second, Err(StorageError::Busy { .. })), "{second:?}");
    drop(first);
    OutputFolder::replace(&scratch.join("out"), CLAIM).expect("free");
}

#[test]
fn what_is_worth_keeping_survives_its_process() {
    for (case, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("keep-{case}"));
        let out = scratch.join("out");
        write_result(&out, "old", 1, place).expect("room");
        let folder = OutputFolder::replace_at(&out, CLAIM, place).expect("its own");
        folder.write_text("map.ply", "hours of work").expect("room");
        folder.keep();
        drop(folder);
        assert_eq!(recover(&out), [scratch.join("out-partial")]);
        assert_eq!(text(out.join("map.ply")).as_deref(), Some("old"));
        assert_eq!(text(scratch.join("out-partial/map.ply")).as_deref(), Some("hours of work"));
        assert_eq!(names(&scratch.0), ["out", "out-partial"]);
        // A commit that is refused saves the files, and says where.
        let mut folder = OutputFolder::replace_at(&out, CLAIM, place).expect("its own");
        folder.write_text("map.ply", "new").expect("room");
        fs::write(out.join("map.ply"), "mine now").expect("room");
        let message = folder.commit_or_save().expect_err("in the way").to_string();
        assert!(message.contains("map.ply") && message.contains("out-partial-2"), "{message}");
        assert_eq!(text(scratch.join("out-partial-2/map.ply")).as_deref(), Some("new"));
    }
}

#[test]
fn a_commit_that_goes_on_never_replaces_what_the_user_put_there() {
    let scratch = TemporaryFolder::new("late");
    let out = scratch.join("out");
    write_result(&out, "old", 1, Place::Inside).expect("room");
    // A dead process had marked its work as committed, and moved nothing yet.
    let folder = OutputFolder::replace_at(&out, CLAIM, Place::Inside).expect("its own");
    folder.write_text("map.ply", "new").expect("room");
    folder.write_text("renders/sharp/000001.png", "new").expect("room");
    folder.die_after_mark();
    fs::write(out.join("map.ply"), "mine").expect("room");
    recover(&out);
    assert_eq!(text(out.join("map.ply")).as_deref(), Some("mine"));
    assert_eq!(text(out.join("renders/sharp/000001.png")).as_deref(), Some("new"));
    assert!(!out.join("renders/sharp/000000.png").exists(), "of the old result");
    assert_eq!(text(out.join("result-kept/map.ply")).as_deref(), Some("new"));
}

/// Folder of the process that is killed, and place of its files.
const CHILD: &str = "I2SLAM_STORAGE_TEST";

/// Replaces and extends a result over and over.
#[test]
#[ignore = "the process that a_killed_process_leaves_a_whole_result kills"]
fn a_process_that_is_killed() {
    let Ok(work) = std::env::var(CHILD) else { return };
    let (place, out) = work.split_once(' ').expect("place and folder");
    let place = PLACES[place.parse::<usize>().expect("a number")];
    for round in 0.. {
        let text = format!("round {round} ").repeat(40 + 17 * (round % 5));
        write_result(out.as_ref(), &text, 3 + round % 4, place).expect("room");
        let mut folder =
            OutputFolder::extend_at(out.as_ref(), "i2slam eval", &[], place).expect("free");
        folder.write_text("report.html", &text).expect("room");
        folder.commit().expect("room");
    }
}

#[test]
#[cfg(unix)]
fn a_killed_process_leaves_a_whole_result() {
    for (name, place) in PLACES.into_iter().enumerate() {
        let scratch = TemporaryFolder::new(&format!("kill-{name}"));
        let out = scratch.join("out");
        write_result(&out, "first", 2, place).expect("room");
        fs::write(out.join("notes.txt"), "mine").expect("room");
        let mut died_with_files = 0;
        for kill in 0..60u64 {
            let program = std::env::current_exe().expect("this program");
            let mut child = Command::new(program)
                .args(["--exact", "tests::a_process_that_is_killed", "--ignored"])
                .env(CHILD, format!("{name} {}", out.display()))
                .stdout(Stdio::null())
                .spawn()
                .expect("a process");
            let begun = |name: &String| name.starts_with(".");
            while !(names(&scratch.0).iter().any(begun) || names(&out).iter().any(begun)) {
                std::thread::yield_now();
            }
            std::thread::sleep(Duration::from_micros(kill * 7_919 % 6_000));
            child.kill().expect("it runs");
            child.wait().expect("it ended");
            let left =
                names(&scratch.0).len() > 1 || names(&out).iter().any(|n| n.starts_with('.'));
            died_with_files += u32::from(left);
            assert_eq!(text(out.join("notes.txt")).as_deref(), Some("mine"), "kill {kill}");
            // Files that are moved one by one are a mixture until the next command.
            if place != Place::Beside {
                recover(&out);
            }
            assert!(is_whole(&out), "kill {kill}: {:?}", names(&out));
            recover(&out);
            assert_eq!(text(out.join("notes.txt")).as_deref(), Some("mine"), "kill {kill}");
            assert!(is_whole(&out), "recovered after kill {kill}: {:?}", names(&out));
            let whole = text(out.join("map.ply")).expect("a map");
            let pictures = names(&out.join("renders/sharp"));
            for picture in pictures {
                let path = out.join("renders/sharp").join(picture);
                assert_eq!(text(path).as_ref(), Some(&whole), "of two results, kill {kill}");
            }
        }
        assert!(
            died_with_files >= 20,
            "only {died_with_files} kills struck while files were written"
        );
        drop(OutputFolder::replace_at(&out, CLAIM, place).expect("free"));
        assert_eq!(names(&scratch.0), ["out"], "dead work is removed");
        assert_eq!(
            names(&out),
            [MANIFEST, "map.ply", "notes.txt", "renders", "report.html"]
                .into_iter()
                .filter(|name| out.join(name).exists())
                .collect::<Vec<_>>()
        );
    }
}
