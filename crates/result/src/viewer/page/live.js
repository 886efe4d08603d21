// Follows a run that goes on: asks the program for what is new, and shows it.
const PAUSE = 1000, run = document.createElement("span");
run.id = "run";
run.role = "status";
$("top").insertBefore(run, $("actions"));
const waiting = document.createElement("p");
waiting.id = "waiting";
$("stage").insertBefore(waiting, $("message"));
let version = 0, silent = 0, followed = 0;

async function ask() {
  let ended = false;
  try {
    const answer = await fetch("update?after=" + version, { cache: "no-store" });
    const { status, ended: last, version: now, latest, state: next } = await answer.json();
    [silent, ended, version] = [0, last, now];
    run.textContent = status;
    if (next) adopt(next, latest ?? Infinity);
  } catch {
    ended = ++silent > 5;
    run.textContent = ended ? "The program has ended; this is the last map it gave." : "Waiting for the program\u2026";
  }
  showWaiting(ended);
  document.body.dataset.run = ended ? "ended" : "on";
  document.body.dataset.version = version;
  if (!ended) setTimeout(ask, PAUSE);
}

// Says why the stage is empty as long as there is no map.
function showWaiting(ended) {
  waiting.hidden = scene.gaussians > 0;
  const path = frames.length ? " The path so far: Overview." : "";
  waiting.textContent = ended ? "There is no map to show." : "No map to show yet." + path;
}

// Replaces scene and map. The view stays; at the last camera that was mapped it goes on to the new one,
// whose frame is `latest`.
function adopt({ scene: next, map }, latest) {
  const atCamera = navigation.at !== null || navigation.glide !== null;
  const follows = !frames.length || atCamera && state.frame === followed;
  const shown = frames[state.frame]?.index;
  frames.splice(0, frames.length, ...next.frames);
  Object.assign(scene, next, { frames, camera: Object.assign(camera, next.camera) });
  navigation.up = scene.up;
  pictures.clear();
  if (renderer) renderer.responseKey = null;
  loadMap(map);
  showFrames();
  state.playing = null;
  followed = Math.max(0, frames.findLastIndex(frame => frame.index <= latest));
  if (follows) return stepTo(followed);
  state.frame = Math.max(0, frames.findLastIndex(frame => frame.index <= shown));
  // Its pose may have been corrected.
  if (atCamera) stepTo(state.frame, 0);
  else showFrame();
}

ask();
