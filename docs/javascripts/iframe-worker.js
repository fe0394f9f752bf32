// The search of a page that is opened as a file: browsers start no worker from files, a hidden frame does its work.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = `<script>
        window.postMessage = data => parent.dispatchEvent(new CustomEvent("from-frame", { detail: [window, data] }));
        window.importScripts = (...urls) => Promise.all(urls.map(url => new Promise((done, failed) => {
          const script = document.createElement("script");
          Object.assign(script, { src: url, onload: done, onerror: failed });
          document.head.append(script);
        })));
      <\/script><script src="${new URL(url, location.href)}"><\/script>`;
      this.isReady = new Promise((ready) => frame.addEventListener("load", () => ready(frame.contentWindow)));
      window.addEventListener("from-frame", ({ detail: [sender, data] }) => {
        if (sender === frame.contentWindow) this.dispatchEvent(new MessageEvent("message", { data }));
      });
      document.body.append(frame);
    }

    postMessage(data) {
      this.isReady.then((inner) => inner.dispatchEvent(new MessageEvent("message", { data })));
    }
  };
}
