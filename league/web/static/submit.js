// Sends the form without leaving the page, so that a refusal keeps all that was filled in.
"use strict";

const form = document.querySelector("form[data-api]");
const refusal = document.querySelector(".refusal");
const button = form.querySelector("button");

async function send() {
  const { token, name, file } = form.elements;
  const answer = await fetch(`${form.dataset.api}?name=${encodeURIComponent(name.value.trim())}`, {
    method: "POST",
    headers: { Authorization: `Bearer ${token.value.trim()}` },
    body: file.files[0],
  });
  const document = await answer.json();
  if (!answer.ok) return document.error;
  location.assign(document.page);
  return "";
}

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  button.disabled = true;
  refusal.hidden = true;
  const sentence = await send().catch(() => "The server did not answer: try again.");
  refusal.textContent = sentence;
  refusal.hidden = !sentence;
  button.disabled = false;
});
