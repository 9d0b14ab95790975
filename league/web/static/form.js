// Sends a form without leaving the page, so that a refusal keeps all that was filled in.
"use strict";

const form = document.querySelector("form[method=post]");
const refusal = document.querySelector(".refusal");

/** Send the form; return why it was refused, or go where the answer leads. */
async function send() {
  const answer = await fetch(form.action, { method: "POST", body: new FormData(form) });
  if (answer.redirected) {
    location.assign(answer.url);
    return "";
  }
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  return page.querySelector(".refusal")?.textContent || `The server answered ${answer.status}.`;
}

form?.addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = form.querySelector("button");
  button.disabled = true;
  refusal.hidden = true;
  const sentence = await send().catch(() => "The server did not answer: try again.");
  refusal.textContent = sentence;
  refusal.hidden = !sentence;
  button.disabled = false;
});
