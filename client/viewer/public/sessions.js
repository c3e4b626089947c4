// Lists the sessions that this server knows (GET /sessions), every three seconds.
const state = document.getElementById("state");
const list = document.getElementById("sessions");
const form = document.getElementById("token-form");
let token = "";

function text(tag, content) {
  const element = document.createElement(tag);
  element.textContent = content;
  return element;
}

function age(seconds) {
  if (seconds < 120) return `${Math.max(0, Math.round(seconds))} s`;
  return seconds < 7200 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

function item(session) {
  const entry = document.createElement("li");
  if (session.picture) {
    const picture = document.createElement("img");
    picture.alt = "";
    picture.referrerPolicy = "no-referrer";
    picture.addEventListener("error", () => picture.remove());
    picture.src = session.picture;
    entry.append(picture);
  }
  const people = session.people === 1 ? "1 person" : `${session.people} people`;
  entry.append(
    text("h2", session.name),
    text("p", `${session.body} · ${people} · for ${age(Date.now() / 1000 - session.started_unix_s)}`),
  );
  const links = document.createElement("nav");
  // Relays first: they are there to be watched.
  const places = session.places.filter((place) => /^https?:\/\//.test(place.http));
  places.sort((a, b) => (a.kind === b.kind ? a.viewers - b.viewers : a.kind === "relay" ? -1 : 1));
  for (const place of places) {
    const link = text("a", place.kind === "relay" ? "Watch" : "Join");
    link.href = `${place.http}/`;
    link.title = `${place.http}, ${place.viewers} there`;
    links.append(link);
  }
  entry.append(links);
  return entry;
}

async function look() {
  try {
    const answer = await fetch("sessions", { headers: token ? { Authorization: `Bearer ${token}` } : {} });
    form.hidden = answer.status !== 401 && answer.status !== 403;
    if (answer.status === 404) throw new Error("This server belongs to no directory (cluster.nats)");
    if (!answer.ok) throw new Error(await answer.text());
    const sessions = await answer.json();
    list.replaceChildren(...sessions.map(item));
    state.textContent = sessions.length > 0 ? "" : "There is no session now.";
  } catch (error) {
    list.replaceChildren();
    state.textContent = error.message;
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  token = document.getElementById("token").value;
  look();
});
look();
setInterval(look, 3000);
