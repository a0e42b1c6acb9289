// The page of a supervisor. What comes from the service is shown as text, never as markup.
const $ = (id) => document.getElementById(id);
const MOST = 300;
let token = sessionStorage.getItem("token");
let api = null;
let last = -1;
let shown = "";

function element(name, text, ...children) {
  const made = document.createElement(name);
  if (text !== null) made.textContent = text;
  made.append(...children);
  return made;
}

async function ask(path, body, key) {
  const headers = { Authorization: `Bearer ${token}` };
  if (key) headers["Idempotency-Key"] = key;
  const answer = await fetch(path, body ? { method: "POST", headers, body: JSON.stringify(body) } : { headers });
  const said = await answer.json();
  if (!answer.ok) throw Object.assign(new Error(said.error), { status: answer.status });
  return said;
}

async function give(command, fields) {
  try {
    const said = await ask(`commands/${command}`, fields, crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`);
    $("said").textContent = said.rejected ? `${command} was rejected: ${said.rejected}` : `${command}: on record as event ${said.seq}.`;
    $("said").className = said.rejected ? "rejected" : "";
  } catch (error) {
    $("said").textContent = `${command} was not taken: ${error.message}`;
    $("said").className = "rejected";
  }
  await look();
}

function card(call, { now_us: now, principal }) {
  const facts = element("dl", null);
  const ends = new Date(Date.now() + (call.ends_us - now) / 1000);
  const left = call.ends_us === null ? "" : ` That is at ${ends.toLocaleTimeString()}.`;
  for (const [name, text] of [["Rule", call.why], ["Known", call.known.join(" ")], ["If nobody answers", call.otherwise + left]]) {
    facts.append(element("dt", name), element("dd", text));
  }
  const replies = element("div", null);
  replies.className = "replies";
  for (const reply of call.replies) {
    const button = element("button", reply.label);
    button.type = "button";
    button.addEventListener("click", () => give("RespondToCall", {
      supervisor: call.supervisor, action_id: call.action_id, approves: reply.approves, preferred: reply.preferred,
    }));
    replies.append(button);
  }
  if (call.supervisor !== principal) replies.replaceChildren(`Asked of ${call.supervisor}, who alone can answer.`);
  const made = element("article", null, element("h3", call.title), facts, replies);
  made.className = "call";
  return made;
}

async function look() {
  const state = await ask("overview");
  $("run").textContent = state.run;
  $("who").textContent = `You are ${state.principal}`;
  document.title = state.calls.length ? `(${state.calls.length}) Human oversight` : "Human oversight";
  $("none").hidden = state.calls.length > 0;
  $("governing").hidden = state.principal.startsWith("auditor/");
  const calls = JSON.stringify(state.calls);
  if (calls !== shown) { // so that the focus stays on a button while other things change
    shown = calls;
    $("calls").replaceChildren(...state.calls.map((call) => card(call, state)));
  }
  $("robots").replaceChildren(...state.robots.map((one) => {
    const does = element("td", one.does ?? "nothing");
    if (one.is_away) does.className = "off";
    const name = element("th", one.robot);
    name.scope = "row";
    return element("tr", null, name, does, element("td", `${one.waiting}`), element("td", one.supervisor));
  }));
  const names = state.robots.flatMap((one) => [one.robot, one.supervisor]).concat(state.tasks, state.calls.map((one) => one.action_id));
  $("names").replaceChildren(...[...new Set(names)].map((name) => Object.assign(element("option", null), { value: name })));
}

const PARTIES = ["executor", "requester", "robot", "helper", "peer", "supervisor", "claimant", "capability", "task_id", "action_id", "reason", "cause", "outcome", "scope"];
function told(columns) {
  const type = columns.type.split(".")[0].replace(/(?<=[a-z])(?=[A-Z])/g, " ").toLowerCase();
  const parts = PARTIES.filter((name) => columns[name] !== undefined).map((name) => `${columns[name]}`);
  if (columns.command) parts.unshift(columns.command, columns.issued_by ?? "");
  return `${type}: ${[...new Set(parts)].join(", ")}`;
}

function note(columns) {
  const item = element("li", null, element("time", `${(columns.time_us / 1e6).toFixed(1)} s`), element("span", told(columns)));
  if (columns.type.startsWith("CommandRejected")) item.className = "rejected";
  $("events").prepend(item);
  while ($("events").childElementCount > MOST) $("events").lastElementChild.remove();
}

let drawn = null; // the page of the run, and the line by which it is fed
let isStale = false;
let isDrawing = false;
window.addEventListener("message", (event) => {
  if (drawn && !drawn.line && event.source === drawn.page && event.data === "drawn") [drawn.line] = event.ports;
});

async function draw() {
  const page = await (await fetch((await ask("view", {})).page)).text();
  return page.match(/<script[^>]* id="data"[^>]*>([^<]*)</)[1]; // which has no < of its own
}

// A long run takes long to draw: the service rests three times as long.
async function redraw() {
  isStale = true;
  if (isDrawing) return;
  isDrawing = true;
  while (isStale && drawn?.line && !drawn.page.closed) {
    isStale = false;
    const began = performance.now();
    await draw().then((data) => drawn.line.postMessage(data), () => {});
    await new Promise((wake) => setTimeout(wake, Math.max(1000, 3 * (performance.now() - began))));
  }
  isDrawing = false;
}

let looking = null;
function soon() {
  looking ??= setTimeout(() => { looking = null; look().catch(() => {}); }, 150);
  redraw();
}

async function follow() {
  for (let pause = 500; token; pause = Math.min(pause * 2, 8000)) {
    try {
      const answer = await fetch(`events?after=${last}`, { headers: { Authorization: `Bearer ${token}` } });
      if (answer.status === 400 || answer.status === 401) {
        const why = answer.status === 401 ? "no principal has this token any more" : (await answer.json()).error;
        $("line").textContent = `not connected: ${why}`;
        return;
      }
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      $("line").textContent = "connected";
      pause = 500;
      soon();
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      for (let rest = ""; ;) {
        const { value, done } = await reader.read();
        if (done) break;
        const lines = (rest + value).split("\n");
        rest = lines.pop();
        for (const line of lines) {
          if (line.startsWith("data: ")) note(JSON.parse(line.slice(6)));
          else if (line.startsWith("id: ")) last = Number(line.slice(4));
        }
        soon();
      }
    } catch { /* told below */ }
    $("line").textContent = "not connected: trying again";
    await new Promise((wake) => setTimeout(wake, pause));
  }
}

function ref(schema) {
  return schema.$ref ? api.components.schemas[schema.$ref.split("/").pop()] : schema;
}

function field(name, schema, isRequired, mine) {
  const choices = (schema.anyOf ?? [schema]).map(ref);
  const options = choices.find((one) => one.enum)?.enum;
  const id = `field-${name}`;
  let input;
  if (options) {
    input = element("select", null, ...(isRequired ? [] : [element("option", "")]), ...options.filter((one) => one !== null).map((one) => element("option", one)));
  } else {
    input = element("input", null);
    const kind = choices.find((one) => one.type !== "null")?.type;
    input.type = kind === "boolean" ? "checkbox" : kind === "integer" ? "number" : "text";
    input.dataset.kind = kind;
    if (kind === "string") input.setAttribute("list", "names");
  }
  input.id = id;
  input.name = name;
  input.required = isRequired && input.type !== "checkbox" && !choices.some((one) => one.type === "null");
  if (mine && ["issued_by", "supervisor"].includes(name)) input.value = mine;
  if (name === "reason") input.value = "human override";
  const label = element("label", name.replaceAll("_", " ") + (input.required ? "" : " (may be empty)"));
  label.htmlFor = id;
  return element("div", null, label, input);
}

function compose() {
  const name = $("command").value;
  const schema = api.components.schemas[name];
  const mine = $("who").textContent.replace("You are ", "");
  $("summary").textContent = api.paths[`/commands/${name}`].post.summary;
  $("fields").replaceChildren(...Object.entries(schema.properties).map(([one, kind]) => field(one, kind, (schema.required ?? []).includes(one), mine)));
}

function composed() {
  const found = {};
  for (const input of $("fields").querySelectorAll("input, select")) {
    const { name, value, type, dataset } = input;
    if (type === "checkbox") found[name] = input.checked;
    else if (value === "") { if (!input.required && (api.components.schemas[$("command").value].required ?? []).includes(name)) found[name] = null; }
    else if (type === "number") found[name] = Number(value);
    else found[name] = dataset.kind === "array" ? value.split(",").map((one) => one.trim()) : value;
  }
  return found;
}

const GOVERNS = ["SetTrust", "SetSupervisionDensity", "SetPolicyRule", "GrantAuthority", "RevokeAuthority", "SetRoleTrust", "SetRolePolicyRule", "SetRecoveryBudget", "SetTrustThresholds", "ReportShift", "SubmitTask", "LeaveFleet"];
async function enter() {
  try {
    await look();
  } catch (error) {
    $("refused").textContent = error.status === 401 ? "No principal has this token." : error.message;
    sessionStorage.removeItem("token");
    token = null;
    return;
  }
  sessionStorage.setItem("token", token);
  $("enter").hidden = true;
  $("desk").hidden = $("leave").hidden = false;
  api ??= await (await fetch("openapi.json")).json();
  $("command").replaceChildren(...GOVERNS.filter((name) => api.paths[`/commands/${name}`]).map((name) => element("option", name)));
  compose();
  follow();
}

$("enter").addEventListener("submit", (event) => {
  event.preventDefault();
  token = $("token").value.trim();
  $("refused").textContent = "";
  enter();
});
$("leave").addEventListener("click", () => {
  sessionStorage.removeItem("token");
  location.reload();
});
$("command").addEventListener("change", compose);
$("govern").addEventListener("submit", (event) => {
  event.preventDefault();
  give($("command").value, composed());
});
$("view").addEventListener("click", async (event) => {
  event.preventDefault();
  const page = window.open("", "_blank"); // at once: a browser blocks what opens later
  drawn = { page, line: null };
  try {
    page.location = (await ask("view", {})).page;
  } catch (error) {
    page?.close();
    $("said").textContent = error.message;
  }
});
if (token) enter();
