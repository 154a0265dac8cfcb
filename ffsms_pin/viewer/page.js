const byId = (id) => document.getElementById(id);
// The facts of the scene that Python wrote (`page.facts`).
const facts = JSON.parse(byId("facts").textContent);
var viewer = null;  // as on Meshcat's own page
let animator = null;

const bytesOf = (base64) => Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));

async function commands() {
  const stream = new Blob([bytesOf(byId("commands").textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const view = new DataView(bytes.buffer), found = [];
  for (let at = 0; at < bytes.length;) {
    const length = view.getUint32(at, true);
    found.push(bytes.subarray(at + 4, at + 4 + length));
    at += 4 + length;
  }
  return found;
}

function element(tag, parent, text, classes) {
  const made = document.createElement(tag);
  if (text) made.textContent = text;
  if (classes) made.className = classes;
  parent.appendChild(made);
  return made;
}

function buildLegend() {
  for (const layer of facts.layers) {
    const label = element("label", byId("legend"));
    const box = element("input", label);
    box.type = "checkbox";
    box.checked = layer.shown;
    box.dataset.layer = layer.name;
    const swatch = element("span", label, "", "swatch");
    swatch.style.background = layer.colour;
    element("span", label, layer.label);
    box.addEventListener("change", () => {
      for (const node of layer.nodes) viewer.set_property(["ffsms", node], "visible", box.checked);
    });
  }
  for (const scale of facts.scales) {
    const part = element("div", byId("legend"), scale.label, "scale");
    element("div", part, "", "bar").style.background = `linear-gradient(to right, ${scale.stops.join(",")})`;
    const ends = element("div", part, "", "ends");
    for (const end of scale.ends) element("span", ends, end);
  }
}

// The last frame at or before a time.
function frameAt(time) {
  let low = 0, high = facts.t.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (facts.t[middle] <= time + 1e-6) low = middle; else high = middle - 1;
  }
  return low;
}

// Events on the time bar: a click goes to one. The middle of the slider's thumb is 8 px inside its ends.
function buildMarks() {
  const length = facts.t[facts.t.length - 1];
  for (const mark of facts.marks) {
    const tick = element("div", byId("track"), "", "mark");
    tick.style.left = `calc(8px + (100% - 16px) * ${mark.t / length})`;
    tick.style.background = mark.colour;
    tick.title = `${mark.t.toFixed(2)} s: ${mark.name}${mark.reason ? ` (${mark.reason})` : ""}`;
    tick.dataset.mark = mark.name;
    tick.addEventListener("click", () => {
      setPlaying(false);
      byId("slider").value = mark.t;
      seek(mark.t);
    });
  }
}

function showReading(time) {
  const k = frameAt(time), words = [`t = ${time.toFixed(2)} s`];
  const past = facts.marks.filter((mark) => mark.t <= time + 1e-6);
  if (past.length) words.push(past[past.length - 1].name);
  for (const reading of facts.readings) {
    words.push(`${reading.label} ${reading.values[k].toFixed(reading.digits)}${reading.unit}`);
  }
  byId("reading").textContent = words.join("    ");
}

function seek(time) {
  animator.seek(time);
  animator.display_progress(time);
  ride();
  showReading(time);
}

// Camera and scene as a view asks for them: a fixed direction, or the base held still under the camera.
let rides = false;

function look(name) {
  const [x, y, z] = facts.cameras[name];
  viewer.camera.position.set(x, z, -y);  // of three.js, where y is up
  viewer.controls.target.set(0, 0, 0);
  rides = name === "base";
  ride();
  viewer.controls.update();
  viewer.set_dirty();
}

// Where the scene's root is: shifted, or so that the base stays where it was at first.
function ride() {
  const [root, base] = [["ffsms"], ["ffsms", "base"]].map((path) => viewer.scene_tree.find(path).object);
  const place = (at) => root.position.set(...at.map((value, i) => value - facts.centre[i]));
  root.quaternion.set(0, 0, 0, 1);
  if (!rides) { place([0, 0, 0]); return; }
  root.quaternion.set(...facts.base.slice(3)).multiply(base.quaternion.clone().invert());
  place(facts.base.slice(0, 3)).sub(base.position.clone().applyQuaternion(root.quaternion));
}

function choices(select, entries, chosen) {
  for (const [value, text] of entries) {
    const option = element("option", select, text);
    option.value = value;
    option.selected = value === chosen;
  }
}

function buildControls() {
  const speeds = [...new Set([0.1, 0.25, 0.5, 1, 2, 4, 8, 16, facts.speed])].sort((a, b) => a - b);
  choices(byId("speed"), speeds.map((x) => [String(x), `${x} x`]), String(facts.speed));
  byId("speed").addEventListener("change", (event) => {
    animator.mixer.timeScale = Number(event.target.value);
  });
  const words = {base: "on the base"};
  choices(byId("camera"), Object.keys(facts.cameras).map((x) => [x, words[x] || x]), facts.camera);
  byId("camera").addEventListener("change", (event) => look(event.target.value));
  byId("record").addEventListener("click", recordPass);
}

// One pass from the beginning as a video file, as fast as this browser draws it.
function recordPass() {
  const kind = ["video/mp4", "video/webm"].find((x) => window.MediaRecorder && MediaRecorder.isTypeSupported(x));
  if (!kind) { showTrouble("This browser cannot record a video; open the page in Chromium or Firefox."); return; }
  const recorder = new MediaRecorder(viewer.renderer.domElement.captureStream(30), {mimeType: kind});
  const parts = [], button = byId("record");
  recorder.ondataavailable = (event) => parts.push(event.data);
  recorder.onstop = () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(parts, {type: kind}));
    link.download = `${document.title}.${kind.slice(6)}`;
    link.click();
    button.disabled = false;
    button.textContent = "Record";
  };
  button.disabled = true;
  button.textContent = "Recording";
  setPlaying(false);
  seek(0);
  recorder.start();
  setPlaying(true);
  let last = 0;
  const end = () => {  // the film starts anew at its end
    if (animator.time < last || !animator.playing) { recorder.stop(); return; }
    last = animator.time;
    requestAnimationFrame(end);
  };
  requestAnimationFrame(end);
}

// Nobody wants the legend for long; over it, it stays.
function foldByItself(seconds) {
  const legend = byId("legend");
  let timer = null;
  const wait = () => { timer = setTimeout(() => { legend.open = false; }, 1000 * seconds); };
  legend.addEventListener("pointerenter", () => clearTimeout(timer));
  legend.addEventListener("pointerleave", wait);
  wait();
}

function setPlaying(playing) {
  if (playing) animator.play(); else animator.pause();
  byId("play").textContent = playing ? "Pause" : "Play";
}

function follow() {
  requestAnimationFrame(follow);
  if (!animator.playing) return;
  if (rides) ride();
  byId("slider").value = animator.time;
  showReading(animator.time);
}

async function start() {
  viewer = new MeshCat.Viewer(byId("meshcat-pane"));
  for (const command of await commands()) viewer.handle_command_bytearray(command);
  viewer.set_3d_pane_size();
  animator = viewer.animator;
  buildLegend();
  buildControls();
  const slider = byId("slider");
  animator.mixer.timeScale = facts.speed;
  slider.max = facts.t[facts.t.length - 1];
  buildMarks();
  slider.addEventListener("input", () => { setPlaying(false); seek(Number(slider.value)); });
  byId("play").addEventListener("click", () => setPlaying(!animator.playing));
  setPlaying(true);
  if (!facts.play) { setPlaying(false); seek(0); }
  look(facts.camera);
  foldByItself(8);
  follow();
  document.body.dataset.ready = "yes";
}

function showTrouble(words) {
  byId("trouble").style.display = "block";
  byId("trouble").textContent = words;
}

start().catch((problem) => {
  showTrouble(`The scene cannot be shown: ${problem.message}. A browser with WebGL is needed.`);
  console.error(problem);
});
