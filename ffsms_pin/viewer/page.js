const byId = (id) => document.getElementById(id);
// The data of the scene, made by `facts` in page.py.
const facts = JSON.parse(byId("facts").textContent);
var viewer = null;  // the variable's name on Meshcat's page
let animator = null;

const bytesOf = (base64) => Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));

async function commands() {
  const stream = new Blob([bytesOf(byId("commands").textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const view = new DataView(bytes.buffer), list = [];
  for (let at = 0; at < bytes.length;) {
    const length = view.getUint32(at, true);
    list.push(bytes.subarray(at + 4, at + 4 + length));
    at += 4 + length;
  }
  return list;
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
  buildBackgroundSwitch();
  for (const scale of facts.scales) {
    const part = element("div", byId("legend"), scale.label, "scale");
    element("div", part, "", "bar").style.background = `linear-gradient(to right, ${scale.stops.join(",")})`;
    const ends = element("div", part, "", "ends");
    for (const end of scale.ends) element("span", ends, end);
  }
}

function buildBackgroundSwitch() {
  const label = element("label", byId("legend"));
  label.id = "white-row";
  const box = element("input", label);
  box.type = "checkbox";
  box.id = "white";
  box.checked = facts.background === "white";
  element("span", label, "white background");
  box.addEventListener("change", () => setBackground(box.checked ? "white" : "dark"));
}

const BACKGROUNDS = {  // red, green and blue at the top and at the bottom of the page
  dark: [[0.01, 0.012, 0.025], [0.05, 0.06, 0.10]],
  white: [[1, 1, 1], [0.86, 0.90, 0.94]],
};

function setBackground(name) {
  const dark = name === "dark";
  document.body.classList.toggle("dark", dark);
  viewer.set_property(["Background"], "top_color", BACKGROUNDS[name][0]);
  viewer.set_property(["Background"], "bottom_color", BACKGROUNDS[name][1]);
  stars.visible = dark;
  for (const node of facts.ink) {
    viewer.scene_tree.find(["ffsms", ...node.split("/")]).object.traverse((item) => {
      if (item.material) item.material.color.set(dark ? 0xf2f2f2 : 0x222222);
    });
  }
  viewer.set_dirty();
}

// One sun, and weak light from other directions, so that shadows are not black.
const SUN = [0.75, -0.6, 0.9];  // direction to the sun, inertial axes
let stars = null;

function lightUp() {
  const {THREE} = MeshCat, reach = sceneRadius();
  for (const light of viewer.scene_tree.find(["Lights"]).object.children) light.visible = false;
  const sun = new THREE.DirectionalLight(0xfff4e0, 1.05);
  sun.position.set(...SUN).multiplyScalar(4 * reach);
  sun.castShadow = true;
  viewer.renderer.shadowMap.type = THREE.PCFShadowMap;  // soft shadows would take a third of the drawing time
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, {left: -reach, right: reach, top: reach, bottom: -reach, near: reach, far: 8 * reach});
  sun.shadow.normalBias = 0.004 * reach;
  const fill = new THREE.DirectionalLight(0xbfd0ff, 0.18);
  fill.position.set(...SUN.map((x) => -x));
  viewer.scene.add(sun, fill, new THREE.AmbientLight(0xffffff, 0.34));
  viewer.scene_tree.find(["ffsms"]).object.traverse((item) => {
    const lit = item.isMesh && !item.material.isMeshBasicMaterial;
    item.castShadow = item.receiveShadow = lit;
  });
  stars = starField(60 * reach);
  viewer.scene_tree.find(["ffsms"]).object.add(stars);
}

// Make random stars on a sphere, the same in every scene.
function starField(radius) {
  const {THREE} = MeshCat, places = [], colours = [];
  let state = 1;
  const random = () => (state = (16807 * state) % 2147483647) / 2147483647;
  for (let i = 0; i < 900; i += 1) {
    const z = 2 * random() - 1, angle = 2 * Math.PI * random(), flat = Math.sqrt(1 - z * z);
    places.push(radius * flat * Math.cos(angle), radius * flat * Math.sin(angle), radius * z);
    const bright = 0.25 + 0.75 * random() ** 3;
    colours.push(bright, bright, bright);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(places, 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
  const material = new THREE.PointsMaterial({size: 1.5, sizeAttenuation: false, vertexColors: true});
  return new THREE.Points(geometry, material);
}

function sceneRadius() {
  return Math.max(...[...facts.seen, ...facts.seen_riding].map((place) => Math.hypot(...place)));
}

// Return the index of the last frame at or before a time.
function frameAt(time) {
  let low = 0, high = facts.t.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (facts.t[middle] <= time + 1e-6) low = middle; else high = middle - 1;
  }
  return low;
}

// Draw the events on the time bar; a click on an event pauses at its time. The slider's ends are 8 px inside the bar.
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
  const k = frameAt(time), texts = [`t = ${time.toFixed(2)} s`];
  const past = facts.marks.filter((mark) => mark.t <= time + 1e-6);
  if (past.length) texts.push(past[past.length - 1].name);
  for (const reading of facts.readings) {
    const value = reading.values[k];
    texts.push(value === null ? reading.without : `${reading.label} ${value.toFixed(reading.digits)}${reading.unit}`);
  }
  const parts = byId("reading").children;
  texts.forEach((text, i) => {
    if (i === parts.length) element("span", byId("reading"));
    parts[i].textContent = text;
  });
  for (let i = texts.length; i < parts.length; i += 1) parts[i].textContent = "";
}

function seek(time) {
  animator.seek(time);
  animator.display_progress(time);
  byId("slider").value = time;
  ride();
  showTrails(time);
  showReading(time);
}

// In the view "base" the camera moves with the base; in all other views its direction is fixed.
let rides = false, viewName = "free", moved = false;
const FIELD = 40;  // [deg] vertical field of view
const MARGIN = 0.9;  // share of the free part of the window that the scene fills

function look(name) {
  viewName = name;
  rides = name === "base";
  moved = false;
  ride();
  fit();
}

// Return the part of the window [pixels] above the control bar and, in a wide window, right of the open legend.
function freeArea() {
  const legend = byId("legend").getBoundingClientRect(), bar = byId("time").getBoundingClientRect();
  const left = isWide() && byId("legend").open ? legend.right : 0;
  return {left, top: 0, right: innerWidth, bottom: bar.top};
}

const isWide = () => innerWidth >= 900 && innerHeight >= 560;

// Place the camera so that the whole motion is visible within an area of the window.
function fit(area = freeArea(), width = innerWidth, height = innerHeight) {
  if (area.right - area.left < 20 || area.bottom - area.top < 20) return;  // a notebook cell that is not shown yet
  const {THREE} = MeshCat, camera = viewer.camera, vector = (x, y, z) => new THREE.Vector3(x, z, -y);  // three.js has y up
  const toward = vector(...facts.cameras[viewName]);
  const right = new THREE.Vector3(0, 1, 0).cross(toward).normalize(), up = toward.clone().cross(right);
  const slope = MARGIN * Math.tan(0.5 * FIELD * Math.PI / 180) / height;
  const across = slope * (area.right - area.left), along = slope * (area.bottom - area.top);
  const ends = [-Infinity, -Infinity, -Infinity, -Infinity];
  for (const place of rides ? facts.seen_riding : facts.seen) {
    const point = vector(...place), depth = point.dot(toward);
    const x = point.dot(right) / across, y = point.dot(up) / along;
    [x, -x, y, -y].forEach((value, i) => { ends[i] = Math.max(ends[i], value + depth); });
  }
  const distance = 0.5 * Math.max(ends[0] + ends[1], ends[2] + ends[3]);
  viewer.controls.target.set(0, 0, 0)
    .addScaledVector(right, 0.5 * across * (ends[0] - ends[1])).addScaledVector(up, 0.5 * along * (ends[2] - ends[3]));
  camera.position.copy(viewer.controls.target).addScaledVector(toward, distance);
  Object.assign(camera, {fov: FIELD, near: 0.02 * distance, far: 200 * distance});
  const middle = [0.5 * (area.left + area.right), 0.5 * (area.top + area.bottom)];
  camera.setViewOffset(width, height, 0.5 * width - middle[0], 0.5 * height - middle[1], width, height);
  viewer.controls.update();
  viewer.set_dirty();
}

// Fit the view to the window after each change of its size, until the user moves the camera.
function followWindow() {
  viewer.controls.addEventListener("start", () => { moved = true; });
  const refit = () => { if (!moved) fit(); };
  window.addEventListener("resize", refit);
  byId("legend").addEventListener("toggle", refit);
}

// Move the scene so that its centre is at the origin, or in the view "base" so that the base stays at its first pose.
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
  const labels = {base: "on the base"};
  choices(byId("camera"), Object.keys(facts.cameras).map((x) => [x, labels[x] || x]), facts.camera);
  byId("camera").addEventListener("change", (event) => look(event.target.value));
  byId("record").addEventListener("click", recordPass);
}

// Record one pass from the beginning as a video file, at no more than 30 frames per second.
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
  const end = () => {  // the animation restarts at its end
    if (animator.time < last || !animator.playing) { recorder.stop(); return; }
    last = animator.time;
    requestAnimationFrame(end);
  };
  requestAnimationFrame(end);
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
  showTrails(animator.time);
  showReading(animator.time);
}

// Draw the segments of each trail up to a time.
function showTrails(time) {
  for (const trail of facts.trails) {
    const last = trail.t.length - 1;
    let segments = 0;
    while (segments < last && trail.t[segments + 1] <= time + 1e-6) segments += 1;
    const mesh = viewer.scene_tree.find(["ffsms", trail.node, "<object>"]).object;
    mesh.geometry.setDrawRange(0, segments === last ? Infinity : 6 * trail.sides * segments);
  }
}

// Show the name of the body under the pointer.
function showTitles() {
  const {THREE} = MeshCat, ray = new THREE.Raycaster(), box = byId("title"), pane = byId("meshcat-pane");
  let waiting = false;
  pane.addEventListener("pointermove", (event) => {
    if (waiting || event.buttons) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      const title = titleAt(ray, event.clientX, event.clientY);
      box.style.display = title ? "block" : "none";
      box.textContent = title;
      box.style.left = `${Math.min(event.clientX + 12, innerWidth - box.offsetWidth - 4)}px`;
      box.style.top = `${Math.max(event.clientY - 30, 4)}px`;
    });
  });
  pane.addEventListener("pointerleave", () => { box.style.display = "none"; });
}

function titleAt(ray, x, y) {
  ray.setFromCamera({x: 2 * x / innerWidth - 1, y: 1 - 2 * y / innerHeight}, viewer.camera);
  const bodies = Object.keys(facts.titles).map((node) => viewer.scene_tree.find(["ffsms", ...node.split("/")]).object);
  for (const hit of ray.intersectObjects(bodies.filter(isShown), true)) {
    const path = [];
    for (let item = hit.object; item && item.name !== "ffsms"; item = item.parent) path.unshift(item.name);
    for (; path.length; path.pop()) {
      const title = facts.titles[path.join("/")];
      if (title) return title;
    }
  }
  return "";
}

function isShown(item) {
  return !item || (item.visible && isShown(item.parent));
}

// Space plays and pauses. The arrow keys move by a hundredth of the motion, with Shift by a tenth; Home and End
// move to its ends.
function listenToKeys() {
  document.addEventListener("keydown", (event) => {
    const on = event.target.tagName;
    if (event.ctrlKey || event.altKey || event.metaKey || on === "SELECT") return;
    if (event.key === " " && (on === "BUTTON" || on === "SUMMARY" || event.target.type === "checkbox")) return;
    const end = facts.t[facts.t.length - 1], step = (event.shiftKey ? 0.1 : 0.01) * end;
    const goTo = {
      ArrowLeft: Math.max(0, animator.time - step), ArrowRight: Math.min(end, animator.time + step), Home: 0, End: end,
    };
    if (event.key === " ") setPlaying(!animator.playing);
    else if (event.key in goTo) { setPlaying(false); seek(goTo[event.key]); }
    else return;
    event.preventDefault();
  });
}

async function start() {
  viewer = new MeshCat.Viewer(byId("meshcat-pane"));
  for (const command of await commands()) viewer.handle_command_bytearray(command);
  viewer.set_3d_pane_size();
  lightUp();
  animator = viewer.animator;
  buildLegend();
  buildControls();
  setBackground(facts.background);
  byId("legend").open = isWide();  // in a small window the legend would cover the scene
  const slider = byId("slider");
  animator.mixer.timeScale = facts.speed;
  slider.max = facts.t[facts.t.length - 1];
  buildMarks();
  slider.addEventListener("input", () => { setPlaying(false); seek(Number(slider.value)); });
  byId("play").addEventListener("click", () => setPlaying(!animator.playing));
  setPlaying(true);
  if (!facts.play) { setPlaying(false); seek(0); }
  look(facts.camera);
  followWindow();
  listenToKeys();
  showTitles();
  follow();
  document.body.dataset.ready = "yes";
}

function showTrouble(message) {
  byId("trouble").style.display = "block";
  byId("trouble").textContent = message;
}

start().catch((problem) => {
  showTrouble(`The scene cannot be shown: ${problem.message}. A browser with WebGL is needed.`);
  console.error(problem);
});
