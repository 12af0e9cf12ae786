// Pages opened from the disk may start no Worker, which the search runs in. Here a hidden frame of
// the same page stands in for it: the script of the worker runs there, and messages go both ways.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.appendChild(frame);
      const inner = frame.contentWindow;
      const waiting = [];
      inner.postMessage = (data) => {
        const event = new MessageEvent("message", { data });
        this.dispatchEvent(event);
        if (this.onmessage) this.onmessage(event);
      };
      inner.importScripts = (...urls) =>
        Promise.all(urls.map((each) => this.load(inner, each)));
      this.send = (data) => waiting.push(data);
      this.load(inner, url).then(() => {
        this.send = (data) => {
          const event = new inner.MessageEvent("message", { data });
          inner.dispatchEvent(event);
        };
        waiting.forEach((data) => this.send(data));
      });
      this.terminate = () => frame.remove();
    }

    load(inner, url) {
      return new Promise((done, failed) => {
        const script = inner.document.createElement("script");
        script.src = url;
        script.onload = done;
        script.onerror = failed;
        inner.document.body.appendChild(script);
      });
    }

    postMessage(data) {
      this.send(data);
    }
  };
}
