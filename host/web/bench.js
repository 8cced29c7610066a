// The bench's page: shows what GET /api/sim says and turns controls into requests.
"use strict";

const POLL_MS = 100;
const PLOT_SECONDS = 10;
const SHOWN_FRAMES = 60;
const FRAMES_PER_POLL = 200;
const STATUS_FRAME = /^STS/;

const SWITCHES = [
  ["powered", "powered"],
  ["bus_connected", "bus connected"],
  ["fwd_limit_closed", "forward limit closed"],
  ["rev_limit_closed", "reverse limit closed"],
  ["index_pin", "index pin high"],
  ["encoder_unplugged", "encoder unplugged"],
  ["stall", "shaft held fast"],
  ["short_circuit", "output shorted"],
  ["gate_driver_fault", "gate driver fault"],
  ["j1_loopback", "self-test loopback on J1"],
];
// Field, label, smallest, largest, step, unit, and for fields that may be null what null means.
const SLIDERS = [
  ["battery_v", "Battery", 0, 30, 0.1, "V", "by its charge"],
  ["load_nm", "Load torque", -2.5, 2.5, 0.01, "N·m"],
  ["analog_v", "AIN1", -0.01, 3.3, 0.01, "V", "potentiometer"],
  ["temp_c", "Case temperature", -20, 130, 1, "°C", "by its losses"],
  ["pulse_width_us", "RC pulse", 999, 2000, 1, "µs", "none"],
];
const VALUES = [
  ["Mode", (n) => n.drive_mode],
  ["Target", (n) => n.target],
  ["Position", (n) => n.position_counts, "counts"],
  ["Velocity", (n) => n.velocity_counts_per_100ms.toFixed(0), "/100 ms"],
  ["Current", (n) => n.current_a.toFixed(2), "A"],
  ["Duty", (n) => percent(n.duty).toFixed(1), "%"],
  ["Bus voltage", (n) => n.bus_v.toFixed(2), "V"],
  ["Temperature", (n) => n.temp_c.toFixed(1), "°C"],
];
const SIGNALS = [
  { name: "velocity", colour: "--plot-1", shown: true, value: (n) => n.velocity_counts_per_100ms },
  { name: "current / A", colour: "--plot-2", shown: true, value: (n) => n.current_a },
  { name: "duty / %", colour: "--plot-3", shown: true, value: (n) => percent(n.duty) },
  { name: "position", colour: "--plot-4", shown: false, value: (n) => n.position_counts },
];
const LAMPS = {
  off: "", red: "#e5372c", orange: "#ff8c1a", yellow: "#f4d21f", green: "#27b34b",
  blue: "#2f6fed", fuchsia: "#d936c8", cyan: "#1fc4d6", white: "#ffffff",
};

const byId = (id) => document.getElementById(id);
const percent = (duty) => duty * 100 / 32767;
const seconds = (us) => (us / 1e6).toFixed(3) + " s";
const thousands = (count) => count.toLocaleString("en").replaceAll(",", "\u202f");

function notice(text) {
  byId("notice").textContent = text;
  byId("notice").hidden = !text;
}

async function request(method, path, body) {
  const options = { method };
  if (body !== undefined) {
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  const answer = await fetch(path, options);
  const result = await answer.json();
  if (!answer.ok) throw new Error(result.error);
  return result;
}

// Sends a command of the user and shows its refusal.
async function act(method, path, body) {
  try {
    await request(method, path, body);
    notice("");
  } catch (error) {
    notice(error.message);
  }
}

// One request at a time for each field, always ending with the latest value.
class Poke {
  constructor(index, field) {
    this.path = `api/sim/nodes/${index}`;
    this.field = field;
    this.busy = false;
  }

  async set(value) {
    this.next = { [this.field]: value };
    if (this.busy) return;
    this.busy = true;
    while (this.next) {
      const body = this.next;
      this.next = null;
      await act("PATCH", this.path, body);
    }
    this.busy = false;
  }
}

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

class Plot {
  constructor(root) {
    this.canvas = root.querySelector("canvas");
    this.samples = [];
    this.signals = SIGNALS.map((signal) => ({ ...signal }));
    for (const signal of this.signals) {
      const label = element("label");
      const box = element("input");
      box.type = "checkbox";
      box.checked = signal.shown;
      box.addEventListener("change", () => { signal.shown = box.checked; this.draw(); });
      const line = element("span");
      line.style.background = `var(${signal.colour})`;
      signal.text = element("output", signal.name);
      label.append(box, line, signal.text);
      root.querySelector(".legend").append(label);
    }
  }

  add(time, node, span) {
    const last = this.samples.at(-1);
    if (last && time < last.time) this.samples = [];
    if (!last || time > last.time) {
      this.samples.push({ time, values: this.signals.map((signal) => signal.value(node)) });
    }
    this.span = span;
    while (this.samples.length > 2 && this.samples[1].time < time - span) this.samples.shift();
    this.draw();
  }

  draw() {
    const { canvas } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width || !this.samples.length) return;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const end = this.samples.at(-1).time;
    const x = (time) => width - (end - time) / this.span * width;
    this.grid(pen, style, width, height, end, x);
    pen.lineWidth = 1.6;
    this.signals.forEach((signal, index) => {
      const scale = fullScale(this.samples.map((sample) => sample.values[index]));
      signal.text.textContent = `${signal.name} ±${thousands(scale)}`;
      if (!signal.shown) return;
      pen.strokeStyle = style.getPropertyValue(signal.colour);
      pen.beginPath();
      for (const sample of this.samples) {
        pen.lineTo(x(sample.time), height / 2 - sample.values[index] / scale * (height / 2 - 4));
      }
      pen.stroke();
    });
  }

  grid(pen, style, width, height, end, x) {
    pen.strokeStyle = style.getPropertyValue("--line");
    pen.fillStyle = style.getPropertyValue("--soft");
    pen.font = "11px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(0, height / 2);
    pen.lineTo(width, height / 2);
    const step = this.span / 5;
    for (let time = Math.ceil((end - this.span) / step) * step; time <= end; time += step) {
      if (time < 0) continue;
      pen.moveTo(x(time), 0);
      pen.lineTo(x(time), height);
      if (x(time) < width - 30) pen.fillText(`${+(time / 1e6).toFixed(1)} s`, x(time) + 3, height - 4);
    }
    pen.stroke();
  }
}

// The smallest of 1, 2, 5, 10, ... that no value exceeds.
function fullScale(values) {
  const largest = Math.max(1, ...values.map(Math.abs));
  const power = 10 ** Math.floor(Math.log10(largest));
  return [1, 2, 5, 10].map((step) => step * power).find((scale) => scale >= largest);
}

class NodeCard {
  constructor(node) {
    const card = byId("node").content.cloneNode(true).firstElementChild;
    this.index = node.index;
    this.title = card.querySelector("h2");
    this.tags = card.querySelector(".tags");
    this.ring = card.querySelector(".ring");
    this.caption = card.querySelector("figcaption");
    this.plot = new Plot(card.querySelector(".plot"));
    this.values = VALUES.map(([name, read, unit]) => {
      const cell = element("div");
      const value = element("dd");
      const number = element("span");
      value.append(number, element("small", unit ? ` ${unit}` : ""));
      cell.append(element("dt", name), value);
      card.querySelector(".values").append(cell);
      return { number, read };
    });
    this.addButtons(card.querySelector(".buttons"));
    this.switches = SWITCHES.map((row) => this.addSwitch(card.querySelector(".switches"), ...row));
    this.sliders = SLIDERS.map((row) => this.addSlider(card.querySelector(".sliders"), ...row));
    byId("nodes").append(card);
  }

  addButtons(parent) {
    const path = `api/sim/nodes/${this.index}`;
    const press = element("button", "Press brake/coast button");
    press.addEventListener("click", () => act("PATCH", path, { press_button: true }));
    const cycle = element("button", "Power cycle");
    cycle.addEventListener("click", () => act("POST", `${path}/power-cycle`));
    for (const button of [press, cycle]) button.type = "button";
    parent.append(press, cycle);
  }

  addSwitch(parent, field, text) {
    const label = element("label");
    const box = element("input");
    box.type = "checkbox";
    const poke = new Poke(this.index, field);
    box.addEventListener("change", () => poke.set(box.checked));
    label.append(box, text);
    parent.append(label);
    return (node) => { if (!poke.busy) box.checked = node.pokes[field] ?? node[field] ?? false; };
  }

  addSlider(parent, field, text, low, high, step, unit, nothing) {
    const label = element("label", text);
    const shown = element("output");
    const slider = element("input");
    Object.assign(slider, { type: "range", min: low, max: high, step });
    const poke = new Poke(this.index, field);
    let held = false;
    // The lowest position of a slider that can be "nothing" stands for it.
    const read = () => (nothing && slider.valueAsNumber === low ? null : slider.valueAsNumber);
    const show = (value) => {
      const digits = step < 1 ? String(step).split(".")[1].length : 0;
      shown.textContent = value === null ? nothing : `${value.toFixed(digits)} ${unit}`;
    };
    slider.addEventListener("input", () => { show(read()); poke.set(read()); });
    slider.addEventListener("pointerdown", () => { held = true; });
    slider.addEventListener("pointerup", () => { held = false; });
    label.append(shown, slider);
    parent.append(label);
    return (node) => {
      if (held || poke.busy) return;
      const value = node.pokes[field] ?? node[field] ?? (nothing ? null : 0);
      slider.value = value ?? low;
      show(value);
    };
  }

  update(node, time, span) {
    const session = node.session === null ? "no session" : `session 0x${node.session.toString(16).toUpperCase().padStart(4, "0")}`;
    this.title.textContent = `Node ${node.index}: ${node.dialect} number ${node.number}`;
    const faults = node.faults.active.map((fault) => [fault, true]);
    const tags = node.powered
      ? [[node.state], [node.link], [session], [node.neutral], ...faults]
      : [["no power", true]];
    if (node.mode === "bootloader") tags.unshift(["bootloader", true]);
    this.tags.replaceChildren(...tags.map(([text, alarm]) => element("span", text, alarm ? "tag alarm" : "tag")));
    for (const { number, read } of this.values) number.textContent = read(node);
    this.showLamps(node.leds);
    this.plot.add(time, node, span);
    for (const refresh of [...this.switches, ...this.sliders]) refresh(node);
  }

  showLamps(leds) {
    const colours = [...leds.ring, leds.brake];
    [...this.ring.children].forEach((lamp, index) => {
      const colour = LAMPS[colours[index]];
      lamp.style.background = colour;
      lamp.style.boxShadow = colour ? `0 0 9px ${colour}` : "";
    });
    const text = `brake LED ${leds.brake}`;
    this.caption.textContent = text;
    this.ring.setAttribute("aria-label", `LED1 to LED4: ${leds.ring.join(", ")}; ${text}`);
  }
}

class Trace {
  constructor() {
    this.since = 0;
    this.frames = [];
  }

  async update(end) {
    // A fast bench makes more frames than a reader can follow: only the last ones are fetched.
    this.since = Math.max(this.since, end - FRAMES_PER_POLL);
    if (end <= this.since) return;
    const fresh = await request("GET", `api/sim/trace?since=${this.since}&limit=${FRAMES_PER_POLL}&decode=true`);
    if (!fresh.length) return;
    this.since = fresh.at(-1).seq + 1;
    if (byId("hold").checked) return;
    this.frames.push(...fresh);
    const wanted = (frame) => !byId("hide-status").checked || !STATUS_FRAME.test(frame.text);
    const shown = this.frames.filter(wanted).slice(-SHOWN_FRAMES);
    this.frames = this.frames.slice(-5 * FRAMES_PER_POLL);
    byId("trace").replaceChildren(...shown.reverse().map(row));
    byId("trace-empty").hidden = shown.length > 0;
    byId("trace-empty").textContent = "Only periodic status frames so far.";
  }
}

function row(frame) {
  const line = element("tr");
  const id = frame.id.toString(16).toUpperCase().padStart(frame.ext ? 8 : 3, "0");
  const from = typeof frame.from === "number" ? `node ${frame.from}` : frame.from;
  const data = frame.rtr ? `remote, length ${frame.dlc}` : frame.data.replace(/../g, "$& ").toUpperCase();
  for (const text of [seconds(frame.t_us), from, id, data, frame.text]) line.append(element("td", text));
  return line;
}

const cards = [];
const trace = new Trace();

function showBench(bench) {
  byId("time").textContent = seconds(bench.t_us);
  byId("pace").textContent = bench.paused ? "paused" : `${bench.speed} × real time`;
  byId("stepper").hidden = !bench.paused;
  byId("load").value = bench.bus_load_percent;
  byId("load-text").textContent = `${bench.bus_load_percent.toFixed(1)} %`;
  byId("frames").textContent = thousands(bench.frames);
  byId("errors").textContent = thousands(bench.error_frames);
  byId("clients").textContent = bench.clients.length;
  byId("clients").title = bench.clients.map((client) => client.name).join("\n");
  const span = PLOT_SECONDS * 1e6 * Math.max(1, bench.speed);
  for (const node of bench.nodes) {
    cards[node.index] ??= new NodeCard(node);
    cards[node.index].update(node, bench.t_us, span);
  }
}

let lost = false;

async function poll() {
  try {
    const bench = await request("GET", "api/sim");
    showBench(bench);
    await trace.update(bench.trace_end);
    if (lost) notice("");
    lost = false;
  } catch (error) {
    lost = true;
    notice(`The bench does not answer (${error.message}). Start it again with: windlass sim`);
  }
  setTimeout(poll, document.hidden ? 10 * POLL_MS : POLL_MS);
}

for (const button of document.querySelectorAll("#stepper button")) {
  button.addEventListener("click", () => act("POST", "api/sim/step", { us: Number(button.dataset.us) }));
}
poll();
