// The page: cameras to step through, exposure and tone, picture as filmed beside the map.
const $ = id => document.getElementById(id);
const scene = JSON.parse($("scene").textContent);
const { frames, camera } = scene;
const stage = $("stage"), canvas = $("canvas");
const SRGB = Array.from({ length: 512 }, (_, i) => {
  const x = (i / 511) ** 4;
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
});
const LINEAR = Array.from({ length: 512 }, (_, i) => (i / 511) ** 4);

// What is shown beside the view.
const state = { frame: 0, stops: 0, balance: true, response: true, compare: true, cut: 50, playing: null };
// Natural logarithm of exposure, and of the gains of white balance.
let tone = { exposure: 0, balance: [0, 0, 0] };
let renderer, pending = null, requested = false, sorting = null, sorted = null, sortId = 0, quality = 1, still = 0, drawn = 0;

// ---- the map's worker

function startService(reply) {
  const text = $("service").textContent;
  try {
    const code = text + ";const serve = mapService((m, t) => postMessage(m, t)); onmessage = e => serve(e.data);";
    const worker = new Worker(URL.createObjectURL(new Blob([code], { type: "text/javascript" })));
    worker.onmessage = event => reply(event.data);
    worker.onerror = () => fail("The map cannot be read: the page is damaged.");
    return message => worker.postMessage(message);
  } catch {
    const serve = mapService(message => setTimeout(reply, 0, message));
    return message => setTimeout(serve, 0, message);
  }
}

const service = startService(message => {
  if (message.texels) return ready(message);
  if (message.order) {
    // An order that comes after a map is of that map.
    if (pending) renderer?.setMap(pending);
    pending = null;
    renderer?.setOrder(message.order);
    sorted = sorting;
    sorting = null;
    return changed();
  }
  if (!(message.depth > 0)) return;
  if (message.pivot === "scene") {
    navigation.sceneScale = message.depth;
    showLines();
  }
  navigation.distance = message.depth;
});

function showLines() {
  const { points, strengths } = lineWork(scene, 0.06 * navigation.scale, state.frame);
  renderer?.setLines(points, strengths);
}

function askPivot(id = "view") {
  const { view } = navigation;
  service({ origin: view.position, forward: navigation.forward(), pixel: 1 / camera.fx, id });
}

// The map of the scene, in the layout of quantise.rs.
function loadMap(base64) {
  const { gaussians, viewColours, viewTerms, chunk, logarithmic, alphaMin } = scene;
  service({ base64, gaussians, viewColours, viewTerms, chunk, logarithmic, alphaMin });
}

// ---- drawing

const navigation = new Navigation(stage, scene, changed, askPivot);
navigation.pixelSize = () => 1 / (camera.fx * fit().scale);

// The camera's picture within the stage: scale, left, top [CSS px].
function fit() {
  const { clientWidth: width, clientHeight: height } = stage;
  const scale = Math.min(width / camera.width, height / camera.height);
  return { scale, left: (width - camera.width * scale) / 2, top: (height - camera.height * scale) / 2, width, height };
}

// Twice the camera's pixels hold all that the map shows; more would cost time alone.
const MAX_SCALE = 2;

function lens(quality) {
  const { scale, left, top, width, height } = fit();
  const ratio = Math.min(devicePixelRatio || 1, MAX_SCALE / scale) * quality;
  const size = [width, height].map(v => Math.max(1, Math.round(v * ratio)));
  const [x, y] = [size[0] / width, size[1] / height];
  return {
    size, scale: scale * x,
    focal: [camera.fx * scale * x, camera.fy * scale * y],
    principal: [(left + camera.cx * scale) * x, (top + camera.cy * scale) * y],
  };
}

function requestSort({ size, focal, principal }) {
  const { view } = navigation, key = JSON.stringify([view, stage.clientWidth, stage.clientHeight]);
  if (sorting || sorted === key) return;
  sorting = key;
  const side = (axis, end) => (end * size[axis] - principal[axis]) / focal[axis];
  service({
    id: ++sortId, origin: view.position, rotation: axesOf(view.rotation).flat(),
    // A margin for views that have moved on when the order comes.
    bounds: [side(0, -0.1), side(1, -0.1), side(0, 1.1), side(1, 1.1)],
    near: scene.near, far: scene.far, pixel: 1 / Math.min(...focal),
  });
}

function gains() {
  if (!scene.tone) return [1, 1, 1];
  return tone.balance.map(v => Math.exp(tone.exposure + (state.balance ? v : 0) + state.stops * Math.LN2));
}

function changed() {
  document.body.dataset.picture = "moving";
  if (requested) return;
  requested = true;
  requestAnimationFrame(tick);
}

function tick(now) {
  requested = false;
  if (!renderer || stage.clientWidth === 0) return;
  play(now);
  const moving = navigation.advance(now) || state.playing !== null || navigation.pointers.size > 0;
  adaptQuality(now, moving);
  const shown = lens(quality), full = fit(), ratio = devicePixelRatio || 1;
  const [width, height] = [Math.round(full.width * ratio), Math.round(full.height * ratio)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  requestSort(shown);
  const away = navigation.at === null && !navigation.glide && state.playing === null;
  renderer.draw(navigation.view, shown, gains(), away);
  drawn++;
  document.body.dataset.drawn = drawn;
  showPlace();
  if (moving && (navigation.glide || navigation.keys.size || state.playing !== null)) changed();
  else settle();
}

// Pictures in motion take fewer pixels where they would come too slowly; at rest they take all.
function adaptQuality(now, moving) {
  const apart = now - (adaptQuality.last ?? -1e9);
  adaptQuality.last = now;
  if (!moving || apart > 500) return;
  adaptQuality.mean = 0.8 * (adaptQuality.mean ?? 16) + 0.2 * apart;
  if (adaptQuality.mean > 24 && quality > 0.35) {
    quality = Math.max(0.35, quality * 0.8);
    adaptQuality.mean = 16;
  }
}

function settle() {
  clearTimeout(still);
  still = setTimeout(() => {
    if (requested || sorting) return;
    if (quality < 1 && !navigation.pointers.size) {
      quality = 1;
      return changed();
    }
    document.body.dataset.picture = "still";
  }, 150);
}

function ready(map) {
  if (renderer) {
    [pending, sorted] = [map, null];
  } else {
    try {
      renderer = new Renderer(canvas, scene, map);
      showResponse();
    } catch (error) {
      return fail(error.message);
    }
  }
  if (!navigation.sceneScale) askPivot("scene");
  $("message").hidden = true;
  changed();
}

function fail(text) {
  $("message").hidden = false;
  $("message").textContent = text;
}

canvas.addEventListener("webglcontextlost", event => {
  event.preventDefault();
  renderer = null;
  fail("The graphics processor was taken away. Reload the page to go on.");
});

// ---- cameras

const toneOf = frame => ({ exposure: frame.logExposure, balance: frame.logWhiteBalance });

function stepTo(place, duration = 350) {
  if (!frames.length) return;
  state.playing = null;
  place = Math.max(0, Math.min(frames.length - 1, place));
  const from = tone, to = toneOf(frames[place]);
  state.frame = place;
  navigation.glideTo(viewOf(frames[place]), duration, () => {
    navigation.at = place;
    askPivot();
  }, t => tone = {
    exposure: from.exposure + t * (to.exposure - from.exposure), balance: mixed(from.balance, to.balance, t),
  });
  showFrame();
}

function play(now) {
  if (state.playing === null) return;
  const end = frames[frames.length - 1].time;
  if (state.playing.start === null) state.playing.start = now - 1000 * state.playing.from;
  const time = (now - state.playing.start) / 1000;
  if (time >= end) {
    state.playing = null;
    stepTo(frames.length - 1, 0);
    return;
  }
  const next = frames.findIndex(f => f.time > time), a = frames[next - 1], b = frames[next];
  // Beside the pictures as filmed the map is shown from their places alone.
  const t = state.compare ? 0 : (time - a.time) / (b.time - a.time);
  navigation.glide = null;
  navigation.view = { position: mixed(a.position, b.position, t), rotation: slerp(a.rotation, b.rotation, t) };
  navigation.at = t ? null : next - 1;
  const [from, to] = [toneOf(a), toneOf(b)];
  tone = { exposure: from.exposure + t * (to.exposure - from.exposure), balance: mixed(from.balance, to.balance, t) };
  if (state.frame !== next - 1) {
    state.frame = next - 1;
    showFrame();
  }
}

function togglePlay() {
  if (state.playing !== null) {
    state.playing = null;
    stepTo(state.frame, 0);
  } else if (frames.length > 1) {
    const from = state.frame < frames.length - 1 ? frames[state.frame].time : 0;
    state.playing = { start: null, from };
    changed();
  }
  showFrame();
}

// A tap on a camera goes there.
navigation.clicked = ([x, y]) => {
  if (navigation.at !== null) return;
  const { scale, left, top } = fit(), box = stage.getBoundingClientRect(), axes = axesOf(navigation.view.rotation);
  const apart = frames.map(frame => {
    const step = sub(frame.position, navigation.view.position), [u, v, z] = axes.map(axis => dot(axis, step));
    if (z < scene.near) return Infinity;
    const at = [left + (camera.fx * u / z + camera.cx) * scale, top + (camera.fy * v / z + camera.cy) * scale];
    return Math.hypot(at[0] - (x - box.left), at[1] - (y - box.top));
  });
  const nearest = apart.indexOf(Math.min(...apart));
  if (apart[nearest] < 24) stepTo(nearest);
};

// ---- what the controls show

const pictures = new Map();

// The picture as filmed, decoded before it is shown.
function picture(place) {
  if (!frames[place]?.picture) return null;
  if (!pictures.has(place)) {
    const image = new Image();
    image.alt = "Frame " + frames[place].name + " as filmed";
    image.src = frames[place].picture;
    image.draggable = false;
    pictures.set(place, image);
  }
  return pictures.get(place);
}

function showPlace() {
  const image = navigation.at !== null && state.compare ? picture(navigation.at) : null;
  const shown = image !== null;
  for (const id of ["outside", "taken", "bar", "before", "after"]) $(id).hidden = !shown;
  $("back").hidden = navigation.at !== null || Boolean(navigation.glide) || state.playing !== null || !frames.length;
  if (!shown) return;
  const { scale, left, top } = fit(), width = camera.width * scale;
  if ($("taken").firstChild !== image) $("taken").replaceChildren(image);
  const place = { left: left + "px", top: top + "px", width: width + "px", height: camera.height * scale + "px" };
  // What the camera did not film is the map on both sides: it is dimmed.
  Object.assign($("outside").style, place);
  Object.assign($("taken").style, place, { clipPath: `inset(0 ${100 - state.cut}% 0 0)` });
  const at = left + width * state.cut / 100, lower = top + camera.height * scale - 10;
  Object.assign($("bar").style, { left: at + "px", top: top + "px", height: camera.height * scale + "px" });
  $("bar").ariaValueNow = Math.round(state.cut);
  Object.assign($("before").style, { left: left + 10 + "px", top: lower + "px" });
  Object.assign($("after").style, { left: left + width - 10 + "px", top: lower + "px" });
}

function showFrame() {
  const frame = frames[state.frame];
  $("steps").hidden = !frame;
  if (!frame) return;
  $("frame").value = state.frame;
  const text = `Frame ${frame.name} · ${state.frame + 1} of ${frames.length} · blur ${frame.blur.toFixed(1)} px`;
  $("caption").textContent = $("frame").ariaValueText = text;
  const playing = state.playing !== null;
  $("play").ariaPressed = playing;
  $("play").ariaLabel = $("play").textContent = playing ? "Pause" : "Play";
  picture(state.frame + 1);
  showLines();
  showResponse();
  showTone();
}

// The tables of a frame's response, one for each channel.
function responseTables(frame) {
  const tables = scene.responses[frame.response].map(text => {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0)), values = new Uint16Array(bytes.buffer);
    return Array.from(values, v => v / 65535);
  });
  return [0, 1, 2].map(c => tables[Math.min(c, tables.length - 1)]);
}

function showResponse() {
  const frame = frames[state.frame];
  const own = scene.tone && state.response && frame;
  const key = !scene.tone ? "none" : own ? frame.response : "neutral";
  if (!renderer || renderer.responseKey === key) return;
  renderer.responseKey = key;
  renderer.setResponse(own ? responseTables(frame) : Array(3).fill(scene.tone ? SRGB : LINEAR));
}

function showTone() {
  const { stops } = state, sign = stops > 0 ? "+" : stops < 0 ? "\u2212" : "\u00b1";
  $("stops").value = stops;
  const own = frames.length ? "the frame\u2019s own exposure" : "the map\u2019s unit";
  $("value").textContent = $("stops").ariaValueText = `${sign}${Math.abs(stops).toFixed(1)} EV`;
  $("stops").title = $("value").title = "Stops above or below " + own;
  for (const [id, name] of [["balance", "White balance"], ["response", "Response"]]) {
    $(id).ariaPressed = state[id];
    $(id).textContent = `${name}: ${state[id] ? "as taken" : "neutral"}`;
  }
  $("response").title = "The camera\u2019s own curve, or sRGB";
  $("balance").title = "The frame\u2019s own white balance, or that of the map";
}

// ---- listeners

function setStops(stops) {
  if (!scene.tone) return;
  state.stops = Math.max(-6, Math.min(6, Math.round(stops * 10) / 10));
  showTone();
  changed();
}

function toggle(name) {
  state[name] = !state[name];
  $(name).ariaPressed = state[name];
  showResponse();
  showTone();
  changed();
}

function showOverview() {
  state.playing = null;
  if (frames.length) navigation.glideTo(overview(frames, navigation.scale, navigation.up), 700);
  showFrame();
}

function setCut(cut) {
  state.cut = Math.max(0, Math.min(100, cut));
  showPlace();
}

function showFrames() {
  $("frame").max = Math.max(0, frames.length - 1);
  $("compare").hidden = !frames.some(f => f.picture);
}

$("frame").oninput = event => stepTo(Number(event.target.value), 150);
$("previous").onclick = () => stepTo(state.frame - 1);
$("next").onclick = () => stepTo(state.frame + 1);
$("back").onclick = () => stepTo(state.frame);
$("play").onclick = togglePlay;
$("compare").onclick = () => toggle("compare");
$("overview").onclick = showOverview;
$("stops").oninput = event => setStops(Number(event.target.value));
$("stops").ondblclick = () => setStops(0);
$("balance").onclick = () => toggle("balance");
$("response").onclick = () => toggle("response");

$("bar").onpointerdown = event => $("bar").setPointerCapture(event.pointerId);
$("bar").onpointermove = event => {
  if (!$("bar").hasPointerCapture(event.pointerId)) return;
  const { scale, left } = fit(), box = stage.getBoundingClientRect();
  setCut((event.clientX - box.left - left) / (camera.width * scale) * 100);
};
$("bar").onkeydown = event => {
  const step = { ArrowLeft: -5, ArrowRight: 5, Home: -100, End: 100 }[event.key];
  if (!step) return;
  event.preventDefault();
  event.stopPropagation();
  setCut(state.cut + step);
};

addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const slider = event.target.matches("input");
  const arrows = !slider && { ArrowLeft: () => stepTo(state.frame - 1), ArrowRight: () => stepTo(state.frame + 1) };
  const actions = {
    ...arrows,
    "+": () => setStops(state.stops + 0.5), "=": () => setStops(state.stops + 0.5), "-": () => setStops(state.stops - 0.5),
    0: () => setStops(0), r: () => stepTo(state.frame), b: () => toggle("compare"), o: showOverview,
  };
  if (!event.target.matches("button")) actions[" "] = togglePlay;
  const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action) return;
  event.preventDefault();
  action();
});
new ResizeObserver(changed).observe(stage);

// The first frame that is not much darker than most, as those of a fade-in are.
function firstLit() {
  const exposures = frames.map(frame => frame.logExposure).sort((a, b) => a - b);
  const typical = exposures[exposures.length >> 1];
  return Math.max(0, frames.findIndex(frame => Math.abs(frame.logExposure - typical) < 2));
}

// `#frame=59`: the frame of that number, or the nearest there is; without, the first that shows something.
function frameOfAddress() {
  const asked = Number(new URLSearchParams(location.hash.slice(1)).get("frame") ?? NaN);
  if (!Number.isFinite(asked)) return firstLit();
  const apart = frames.map(f => Math.abs(f.index - asked));
  return Math.max(0, apart.indexOf(Math.min(...apart)));
}
addEventListener("hashchange", () => stepTo(frameOfAddress()));

for (const id of ["stops", "balance", "response"]) $(id).disabled = !scene.tone;
if (!scene.tone) $("tone").title = "This run has no high dynamic range: exposure, white balance and response were switched off.";
showFrames();
stepTo(frameOfAddress(), 0);
showFrame();
showTone();
loadMap($("map").textContent);
$("map").remove();
